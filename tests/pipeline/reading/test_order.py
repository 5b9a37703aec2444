"""Clocks that were set, wrong times, and messages that stand in the file in another order."""

import random
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.logs.information import format_log, inspect_log
from wayside.pipeline.reading import layout, video
from wayside.pipeline.reading.clocks import pair_times, stream_times
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.records import ScanReport
from wayside.pipeline.reading.survey import survey_log
from wayside.pipeline.reading.video import image_messages
from wayside.schemas.errors import InputError
from wayside.schemas.settings import ReadSettings

from .conftest import LATENCY, STEP
from .conftest import read as read_log

read = partial(read_log, thin_m=0.0)
SECOND, HOUR, YEAR = 10**9, 3600 * 10**9, 365 * 86400 * 10**9
COUNT = 32
TURN = [0.5, -0.5, 0.5, -0.5]
KINDS = {
    "/camera/calibration": "calibration",
    "/pose": "pose",
    "/gps": "fix",
    "/camera/image": "image",
}


def content(topic, index):
    if topic == "/pose":
        return {"position": [8.0 * index, 0.1 * index, 1.5], "rotation": TURN}
    if topic == "/gps":
        return {"place": (48.0 + 7e-5 * index, 11.0, 500.0)}
    return {}


def messages(without=()):
    """Topic, number, header time and log time of every message, in the order they are recorded in."""
    return [
        (topic, index, index * STEP, index * STEP + 10_000_000 * (k + 1))
        for index in range(COUNT)
        for k, topic in enumerate(KINDS)
        if topic not in without
    ]


def moved(rows, ns, since=0, until=COUNT, topics=tuple(KINDS), header=True, log=True):
    return [
        (t, i, h + ns * header, at + ns * log)
        if t in topics and since <= i < until
        else (t, i, h, at)
        for t, i, h, at in rows
    ]


def write(new_log, rows, **options):
    log = new_log(**({"chunk_size": 3000} | options))
    for topic, index, header, logged in rows:
        if topic == "/camera/image":
            log.add_image(index, header, late=logged - header)
        else:
            log.add(topic, KINDS[topic], header, late=logged - header, **content(topic, index))
    return log.finish()


def told(frames):
    """What does not depend on the clocks: images in order, with their poses and fixes to a centimetre."""
    return [
        (
            frame.index,
            frame.status,
            bytes(frame.data),
            None if frame.pose is None else frame.pose.pose.centre.round(2).tolist(),
            None if frame.fix is None else round(frame.fix.latitude_deg, 7),
        )
        for frame in frames
    ]


IMAGES, LOG, HEADER = ("/camera/image",), {"header": False}, {"log": False}
CLOCKS = {
    "log back an hour, headers sound": (-HOUR, 16, COUNT, tuple(KINDS), LOG),
    "headers back": (-HOUR, 20, COUNT, tuple(KINDS), HEADER),
    "the camera's headers back": (-HOUR, 20, COUNT, IMAGES, HEADER),
    "first image logged a year ahead": (YEAR, 0, 1, IMAGES, LOG),
    "one image header a year ahead": (YEAR, 9, 10, IMAGES, HEADER),
    "first image header a year back": (-YEAR, 0, 1, IMAGES, HEADER),
    "one pose header five seconds ahead": (5 * SECOND, 9, 10, ("/pose",), HEADER),
    "one fix header a year ahead": (YEAR, 9, 10, ("/gps",), HEADER),
}
"""Header and log times differ by another offset in a part of a stream: one of the two is right."""
ORDERS = {
    "reversed": lambda rows: rows[::-1],
    "images last": lambda rows: sorted(rows, key=lambda row: list(KINDS).index(row[0])),
    "images first": lambda rows: sorted(rows, key=lambda row: -list(KINDS).index(row[0])),
    "halves exchanged": lambda rows: rows[64:] + rows[:64],
    "parts shuffled": lambda rows: [
        row for k in (3, 0, 2, 1) for row in rows[len(rows) // 4 * k : len(rows) // 4 * (k + 1)]
    ],
}


@pytest.mark.parametrize("without", [(), ("/gps",), ("/pose",)])
@pytest.mark.parametrize("attack", sorted(CLOCKS))
def test_a_wrong_time_costs_no_image_no_pose_and_is_counted(new_log, attack, without):
    *change, clock = CLOCKS[attack]
    rows = messages(without)
    attacked = moved(rows, *change, **clock)
    sound, _ = read(write(new_log, rows))
    frames, report = read(write(new_log, attacked, name="attacked.mcap"))
    assert told(frames) == told(sound)
    assert {f.status for f in frames} == {"used"}
    seconds = np.diff([f.time_ns for f in frames]) / 1e9
    assert ((seconds > 0.05) & (seconds < 0.8)).all()
    assert any("do not fit their log times" in note for note in report.notes) == (rows != attacked)


@pytest.mark.parametrize(("size", "since"), [(3 * SECOND, 16), (6 * SECOND, 26)])
def test_a_clock_set_back_into_the_recording_leaves_no_order_and_is_refused(new_log, size, since):
    path = write(new_log, moved(messages(), -size, since))
    with pytest.raises(InputError, match=r"order of the images of /camera/image is not known.*Cut"):
        read(path)
    assert "is not known" in format_log(inspect_log(path))


def test_headers_tell_the_order_where_the_log_clock_was_set_back(new_log):
    sound, _ = read(write(new_log, messages()))
    path = write(new_log, moved(messages(), -3 * SECOND, 16, header=False), name="attacked.mcap")
    frames, _ = read(path)
    assert told(frames) == told(sound)
    assert [f.time_ns for f in frames] == [f.header_time_ns for f in frames]


@pytest.mark.parametrize("without", [(), ("/pose",)])
@pytest.mark.parametrize("packing", [{}, {"use_chunking": False}])
@pytest.mark.parametrize("order", sorted(ORDERS))
def test_messages_in_any_order_give_the_frames_of_the_sound_log(new_log, order, packing, without):
    rows = messages(without)
    sound, before = read(write(new_log, rows, **packing))
    frames, report = read(write(new_log, ORDERS[order](rows), name="attacked.mcap", **packing))
    assert told(frames) == told(sound)
    assert [f.time_ns for f in frames] == [f.time_ns for f in sound]
    assert report.notes == before.notes
    assert report.bytes_read == report.bytes_total
    assert report.messages == len(rows)
    assert not report.problem_count


@pytest.mark.parametrize("seed", range(4))
def test_messages_late_within_a_window_give_the_same_frames(new_log, bits, seed):
    draw = random.Random(seed)
    rows = messages()
    sound, _ = read(write(new_log, rows))
    mixed = sorted(rows, key=lambda row: row[3] + draw.randrange(SECOND))
    frames, report = read(write(new_log, mixed, name="attacked.mcap"))
    assert bits([replace(f, data=bytes(f.data)) for f in frames]) == bits(
        [replace(f, data=bytes(f.data)) for f in sound]
    )
    assert report.notes == []


def test_a_pause_of_the_recording_is_no_fault(new_log):
    frames, report = read(write(new_log, moved(messages(), HOUR, 16)))
    assert {f.status for f in frames} == {"used"}
    assert frames[16].time_ns - frames[15].time_ns == HOUR + STEP
    assert report.notes == []
    assert all(f.settled_time_ns is None for f in frames)


def test_messages_that_wait_for_a_slow_disk_keep_their_header_times(new_log):
    rows = [(t, i, h, at if not 8 <= i < 24 else 24 * STEP + i) for t, i, h, at in messages()]
    frames, report = read(write(new_log, rows))
    assert [f.time_ns for f in frames] == [f.header_time_ns for f in frames]
    assert all(f.pose is not None for f in frames)
    assert report.notes == []


@pytest.mark.parametrize(
    ("keep", "unused"), [(range(8, COUNT), 8), (range(16), 0), (set(range(COUNT)) - {9}, 0)]
)
@pytest.mark.parametrize(("source", "other"), [("/pose", "/gps"), ("/gps", "/pose")])
def test_poses_or_fixes_for_a_part_only_lose_no_image_behind_the_first(
    new_log, keep, unused, source, other
):
    rows = [row for row in messages((other,)) if row[0] != source or row[1] in keep]
    path = write(new_log, rows)
    frames, report = read(path)
    assert [f.status for f in frames] == ["no_position"] * unused + ["used"] * (COUNT - unused)
    assert report.statuses.get("no_position", 0) == unused
    lost = "left out, without a pose or fix near in time"
    assert [n.split()[0] for n in report.notes if lost in n] == [str(unused)] * (unused > 0)
    frames, _ = read(path, spacing_m=8.0)
    assert {f.status for f in frames} == {"used"}
    assert all(f.spacing_m == 8.0 for f in frames[1:])


def stamped(log, header):
    return stream_times(np.array(log, np.int64), np.array(header, np.int64))


@given(
    st.lists(st.integers(1, 1000), min_size=2, max_size=60),
    st.integers(-(10**12), 10**12),
    st.integers(0, 10**9),
)
def test_sound_times_are_left_as_they_are(steps, offset, latency):
    log = np.cumsum(np.array(steps, np.int64)) * 10**6 + 10**16
    times = stamped(log, log + offset)
    assert (times.capture_ns == log + offset).all()
    assert times.off == 0
    other = stamped(log + latency, log + offset)  # the same clock, recorded later
    paired = pair_times(times, other)
    if latency == 0 or (offset <= 0 and latency - offset <= 1_500_000_000):
        assert paired.by == "header"
    assert pair_times(times, times).by == "header"


LOG_NS = np.arange(40) * STEP + 10**18
CAMERA = stamped(LOG_NS, LOG_NS - LATENCY)


@pytest.mark.parametrize("ahead", [18 * SECOND, 37 * SECOND, 2 * SECOND, -5 * SECOND, SECOND // 2])
def test_log_times_pair_streams_whose_header_clocks_differ(ahead):
    paired = pair_times(CAMERA, stamped(LOG_NS + 1, LOG_NS - 5 * LATENCY + ahead))
    assert paired.by == "log"
    assert paired.apart_ns == pytest.approx(ahead - 4 * LATENCY, abs=2)
    assert (paired.stream_ns == LOG_NS + 1).all()


def test_a_receiver_is_paired_by_log_times_where_it_is_late_and_a_computed_pose_by_headers():
    late = stamped(LOG_NS + 1, LOG_NS - SECOND // 2)
    assert pair_times(CAMERA, late).by == "header"
    paired = pair_times(CAMERA, late, own_clock=True)
    assert paired.by == "log"
    assert paired.apart_ns == pytest.approx(LATENCY - SECOND // 2, abs=2)
    waits = np.random.default_rng(2).integers(0, SECOND, 40)
    assert pair_times(CAMERA, stamped(LOG_NS + waits, LOG_NS), own_clock=True).by == "header"


@pytest.mark.parametrize("unit", [0, 1000, SECOND])
def test_headers_pair_where_log_times_are_unset_coarse_or_in_other_units(unit):
    log = LOG_NS // unit if unit else np.zeros(40, np.int64)
    paired = pair_times(stamped(log, LOG_NS), stamped(log, LOG_NS - 7))
    assert (paired.by, paired.apart_ns) == ("header", 0)


def test_log_times_pair_where_headers_are_whole_seconds_or_not_set():
    for header in (LOG_NS // SECOND * SECOND, np.zeros(40, np.int64), np.full(40, 10**18)):
        paired = pair_times(stamped(LOG_NS, header), CAMERA)
        assert paired.by == "log"
        assert (paired.images_ns == LOG_NS).all()
    once = np.arange(20) * SECOND + 10**18  # a receiver that reports once a second
    assert stamped(once + LATENCY, once).has_header


TIMES = st.one_of(st.sampled_from([0, 1, 2**62 - 1]), st.integers(0, 2**62 - 1))


@given(st.lists(st.tuples(TIMES, TIMES), min_size=1, max_size=60))
def test_times_of_any_size_are_judged(pairs):
    log_ns, header_ns = np.repeat(np.array(pairs, np.int64), 3, axis=0).T
    times = stamped(log_ns, header_ns)
    assert len(times.capture_ns) == len(log_ns)
    pair_times(times, stamped(header_ns, log_ns))


def test_a_log_that_is_read_in_another_order_is_bounded_in_all(new_log, monkeypatch):
    path = write(new_log, ORDERS["reversed"](messages()), chunk_size=20_000)
    survey, topic = survey_log(path), "/camera/image"
    backwards = np.arange(len(survey.images[topic].offset))[::-1]
    one_by_one = list(image_messages(survey, topic, backwards, ScanReport()))
    assert [row for row, _ in one_by_one] == backwards.tolist()
    monkeypatch.setattr(video, "_MOST_KEPT_BYTES", 0)
    monkeypatch.setattr(layout, "UNPACKED_RATIO", 1)
    monkeypatch.setattr(layout, "EXTRA_BYTES", 0)
    halves = np.sort(backwards).reshape(2, -1).T.ravel()  # each image is in another chunk
    with pytest.raises(InputError, match=r"in the order of their times.*mcap sort"):
        list(image_messages(survey, topic, halves, ScanReport()))


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_of_a_log_that_is_still_written_the_messages_are_used_that_stood_there(new_log, share):
    path = write(new_log, messages())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    wanted, _ = read(path)
    report = ReadReport()
    frames = read_frames(path, ReadSettings(thin_m=0.0), report)
    path.write_bytes(content)
    found = list(frames)
    assert 0 < len(found) == len(wanted) < COUNT
    assert told(found) == told(wanted)
    assert "the log grew while it was read" in str(report.problems[-1])


def test_a_log_that_is_changed_while_it_is_read_is_refused(new_log):
    path = write(new_log, messages())
    content = bytearray(path.read_bytes())
    frames = read_frames(path, ReadSettings(thin_m=0.0), ReadReport())
    content[len(content) // 3] ^= 0xFF  # in a chunk, whose messages are lost with it
    path.write_bytes(content)
    with pytest.raises(InputError, match="changed while it was read"):
        list(frames)


def test_information_tells_of_clocks_before_anything_is_run(new_log):
    path = write(new_log, moved(messages(), 18 * SECOND, topics=("/gps",), log=False))
    text = format_log(inspect_log(path))
    assert "note: the clock of the fixes of /gps is 18.01 s ahead of that of the images" in text
    assert "can be used: wayside run" in text


@pytest.mark.parametrize("pause", [2 * 60 * SECOND, 45 * 60 * SECOND])
def test_a_message_long_before_or_after_all_others_in_order_is_no_fault(new_log, pause):
    rows = messages()
    early = [(*rows[0][:2], rows[0][2] - pause, rows[0][3] - pause), *rows[1:]]
    late = [*rows[:-1], (*rows[-1][:2], rows[-1][2] + pause, rows[-1][3] + pause)]
    for k, attacked in enumerate((early, late)):
        frames, report = read(write(new_log, attacked, name=f"{k}.mcap"))
        alone = [f.index for f in frames if f.status == "no_position"]  # nothing tells its place
        assert alone == [COUNT - 1] * k
        assert len(report.notes) == k
        assert all(f.time_ns == f.header_time_ns for f in frames)
