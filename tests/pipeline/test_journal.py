"""What is kept of an image comes back as it was, and a journal of something else is not used."""

import dataclasses
import os
import pickle
import struct
import zlib
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.running.journal import JOURNAL, Journal, journal_key, remove_journal
from wayside.schemas.detections import (
    LEARNED_COLORS,
    Candidates,
    Detections,
    Dropped,
    Features,
    Regions,
    Segmentation,
)
from wayside.schemas.errors import OutputError, UsageError
from wayside.schemas.frame import Frame, Image

from ..conftest import bits_of

KEY = {"log": "a"}
WIDTH, HEIGHT = 640, 480


def image(index, width=WIDTH):
    frame = Frame(index, index, None, "used", "jpeg", b"", None)
    return Image(frame, np.zeros((HEIGHT, width, 3), np.uint8), np.zeros((HEIGHT, width), np.uint8))


def detections(index, rows=5, points=7, optional=True):
    rng = np.random.default_rng(index)
    box = (rng.random((rows, 4)) * 200 + (0, 0, 200, 200)).astype(np.float32)
    area = rng.integers(0, 9, rows).astype(np.int32)
    rgb = rng.random((rows, 3)).astype(np.float32)
    found = Candidates.of(Regions(box, area, rgb, rng.integers(0, 5, rows).astype(np.uint8)))
    score = np.where(rng.random(rows) < 0.5, np.nan, rng.random(rows)).astype(np.float32)
    found = dataclasses.replace(found, score=score)
    if optional:
        some = rng.random((rows, len(LEARNED_COLORS))).astype(np.float32)
        found = dataclasses.replace(found, back_score=-score, color_log_probability=-some)
    features = Features(
        rng.random((points, 2)).astype(np.float32),
        rng.integers(0, 256, (points, 32)).astype(np.uint8),
        *dataclasses.astuple(Features.empty())[2:],
    )
    colors, none = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
    regions, dropped = Regions.empty(), Dropped(index, 3)
    seen = Segmentation(image(index), regions, rows + 3, colors, none, (0, 0), dropped=dropped)
    return Detections(seen, found, features)


def write(folder, items, key=KEY):
    with closing(Journal(folder, key)) as journal:
        assert list(journal.record(iter(items))) == list(items)
    return journal.replayed


@given(rows=st.integers(0, 40), points=st.integers(0, 40), optional=st.booleans())
def test_what_is_kept_comes_back_bit_by_bit(tmp_path_factory, rows, points, optional):
    folder = tmp_path_factory.mktemp("out")
    items = [detections(index, rows, points, optional) for index in (0, 1, 5)]
    assert write(folder, items) == 0
    with closing(Journal(folder, KEY)) as journal:
        assert journal.replayed == 3
        assert [index for index in range(6) if index in journal] == [0, 1, 5]
        for item in reversed(items):
            found = journal.replay(item.image)
            assert bits_of(found) == bits_of(item)
            assert found.candidates.center.flags.writeable


@given(cut=st.integers(1, 3000))
def test_a_torn_end_is_cut_off_and_written_again(tmp_path_factory, cut):
    folder = tmp_path_factory.mktemp("out")
    items = [detections(index) for index in range(4)]
    write(folder, items)
    path = folder / JOURNAL
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    write(folder, items)
    assert path.read_bytes() == whole


class Harm:
    """Makes a folder where it is unpickled."""

    def __reduce__(self):
        return os.mkdir, ("harm",)


def as_an_entry(content):
    return struct.pack("<III", 0, len(content), zlib.crc32(content)) + content


def changed_in_the_middle(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    ("change", "key", "note", "kept"),
    [
        (lambda content: b"", KEY, "not used", range(1)),
        (lambda content: b"no journal", KEY, "not used", range(1)),
        (lambda content: as_an_entry(pickle.dumps(Harm())), KEY, "not used", range(1)),
        (lambda content: content, {"log": "b"}, "another version, log, settings or mod", range(1)),
        (changed_in_the_middle, KEY, "cut or altered", range(1, 4)),
    ],
    ids=["empty", "text", "pickle", "another key", "a changed byte"],
)
def test_what_is_no_sound_journal_of_this_run_is_not_used_and_said(
    tmp_path, monkeypatch, change, key, note, kept
):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, [detections(index) for index in range(4)])
    path = tmp_path / JOURNAL
    path.write_bytes(change(path.read_bytes()))
    with closing(Journal(tmp_path, key)) as journal:
        assert journal.replayed in kept
        assert note in journal.note
        replayed = journal.replayed
    assert write(tmp_path, [detections(9)], key) == replayed
    assert write(tmp_path, [], key) == replayed + 1
    assert not (tmp_path / "harm").exists()


def test_what_was_found_in_an_image_of_another_size_is_not_taken_for_this_one(tmp_path):
    item = detections(0)
    write(tmp_path, [item])
    with closing(Journal(tmp_path, KEY)) as journal:
        assert journal.replay(item.image) is not None
        assert journal.replay(image(0, width=WIDTH + 1)) is None
        assert journal.replay(Image(item.frame, None, None)) is None


def test_a_link_in_the_place_of_the_journal_is_not_followed(tmp_path):
    (tmp_path / "precious").write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    (out / JOURNAL).symlink_to(tmp_path / "precious")
    with pytest.raises(OutputError, match="the journal cannot be written"):
        Journal(out, KEY)
    assert (tmp_path / "precious").read_text() == "mine"


def test_the_key_changes_with_all_that_a_result_depends_on(tmp_path):
    log = tmp_path / "drive.mcap"
    log.write_bytes(b"a drive")
    plain, _ = load_settings()
    models = load_models(plain)
    key = journal_key(log, plain, models)
    more, _ = load_settings(options={"run.workers": 1})
    assert journal_key(log, more, models) == key
    other, _ = load_settings(options={"segment.clusters": 9})
    assert journal_key(log, other, models) != key
    log.write_bytes(b"b drive")
    assert journal_key(log, plain, models) != key
    with pytest.raises(UsageError, match="--resume"):
        journal_key(tmp_path / "none.mcap", plain, models)


def test_a_journal_goes_when_the_result_stands(tmp_path):
    write(tmp_path, [detections(0)])
    remove_journal(tmp_path)
    remove_journal(tmp_path)
    assert os.listdir(tmp_path) == []
