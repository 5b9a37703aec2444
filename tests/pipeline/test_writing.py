"""Files appear whole or not at all, nothing of the user's goes, and a full disk has words."""

import errno
import os
import stat
from pathlib import Path

import pytest

from wayside.pipeline.files import writing
from wayside.pipeline.files.output_folder import OutputFolder
from wayside.pipeline.files.writing import PART, whole_file, write_file, write_json
from wayside.pipeline.fleet.folders import locked_inventory
from wayside.schemas.errors import OutputError


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_appears_when_its_block_ends(tmp_path):
    path = tmp_path / "a.bin"
    with whole_file(path) as stream:
        stream.write(b"one")
        assert not path.exists()
    assert path.read_bytes() == b"one"
    assert names_in(tmp_path) == ["a.bin"]
    (tmp_path / "plain").touch()
    assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_an_address_is_refused_and_makes_no_folder_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    place = Path("s3://bucket/drive")
    with pytest.raises(OutputError, match="is an address"):
        write_file(place, b"one")
    for folder in (OutputFolder(place), locked_inventory(place)):
        with pytest.raises(OutputError, match="is an address"), folder:
            pass
    write_file(Path("s3: or not"), b"one")
    assert names_in(tmp_path) == ["s3: or not"]


def test_an_error_in_the_block_leaves_what_stood_there(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")

    def write():
        with whole_file(path, overwrite=True) as stream:
            stream.write(b"new")
            raise ValueError("no more")

    with pytest.raises(ValueError, match="no more"):
        write()
    assert path.read_bytes() == b"old"
    assert names_in(tmp_path) == ["a.bin"]


def test_a_file_of_the_users_is_refused_and_kept(tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b"mine")
    with pytest.raises(OutputError, match="--overwrite"):
        write_file(path, b"other")
    assert path.read_bytes() == b"mine"
    assert names_in(tmp_path) == ["a.json"]
    for overwrite in (True, False):  # the same bytes once more are never refused
        write_file(path, b"other", overwrite=overwrite)
    assert path.read_bytes() == b"other"


@pytest.mark.parametrize(
    ("earlier", "refused"),
    [('{"wanted": 1, "more": 2}', False), ('{"more": 2}', True), ("[1]", True), ("{", True)],
)
def test_figures_replace_earlier_figures_and_nothing_else(tmp_path, earlier, refused):
    path = tmp_path / "figures.json"
    path.write_text(earlier)
    if refused:
        with pytest.raises(OutputError, match="taken by another file"):
            write_json(path, {"wanted": 3}, ("wanted",))
        assert path.read_text() == earlier
    else:
        write_json(path, {"wanted": 3}, ("wanted",))
        assert '"wanted": 3' in path.read_text()


def test_a_link_in_the_place_of_a_scratch_file_is_not_followed(tmp_path, monkeypatch):
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    monkeypatch.setattr(writing.secrets, "token_hex", lambda n: "00")
    (tmp_path / f".a.bin.00{PART}").symlink_to(victim)
    with pytest.raises(OutputError, match="File exists"):
        write_file(tmp_path / "a.bin", b"other")
    assert victim.read_bytes() == b"precious"


def test_a_link_stays_and_what_it_points_to_is_replaced_if_it_is_not_itself(tmp_path):
    (tmp_path / "a.bin").write_bytes(b"old")
    (tmp_path / "latest").symlink_to("a.bin")
    write_file(tmp_path / "latest", b"new", overwrite=True)
    assert (tmp_path / "latest").is_symlink()
    assert (tmp_path / "a.bin").read_bytes() == b"new"
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OutputError, match="symbolic links"):
        write_file(tmp_path / "loop", b"new")


def test_devices_are_written_as_they_are():
    write_file(writing.Path("/dev/null"), b"gone")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


def test_two_writers_of_a_file_do_not_disturb_each_other(tmp_path):
    path = tmp_path / "a.bin"
    with whole_file(path) as first:
        first.write(b"first")
        first.flush()
        write_file(path, b"second")
        assert len(names_in(tmp_path)) == 2
        with pytest.raises(OutputError, match="another file"):
            write_file(path, b"third")
    assert path.read_bytes() == b"first"  # nothing stood there when it began
    assert names_in(tmp_path) == ["a.bin"]


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOSPC, "Free some space"),
        (errno.EDQUOT, "quota"),
        (errno.EIO, "The disk reports a fault"),
        (errno.EACCES, "Name another file"),
    ],
)
def test_every_fault_of_the_disk_has_its_advice_and_leaves_the_file_of_before(
    tmp_path, monkeypatch, number, advice
):
    def fail(opened):
        raise OSError(number, os.strerror(number))

    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    monkeypatch.setattr(writing.os, "fsync", fail)
    with pytest.raises(OutputError, match=advice) as caught:
        write_file(path, b"some", overwrite=True)
    assert caught.value.exit_status == 5
    assert path.read_bytes() == b"old"
    assert names_in(tmp_path) == ["a.bin"]
