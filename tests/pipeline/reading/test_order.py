"""Clocks that were set, wrong times, and messages that stand in the file in another order."""

import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.information import describe_log, format_information
from wayside.pipeline.reading import replay
from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.clocks import settle_headers, settle_log
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.layout import LATEST_NS
from wayside.pipeline.reading.replay import messages_of
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.survey import survey_log
from wayside.schemas.errors import InputError
from wayside.schemas.settings import ReadSettings

STEP = 10**9 // 4
SECOND, HOUR, YEAR = 10**9, 3600 * 10**9, 365 * 86400 * 10**9
COUNT = 32
TURN = [0.5, -0.5, 0.5, -0.5]
KINDS = {
    "/camera/calibration": "calibration",
    "/pose": "pose",
    "/gps": "fix",
    "/camera/image": "image",
}
WITHOUT = {"poses": "/gps", "fixes": "/pose"}


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


def read(path, **settings):
    report = ReadReport()
    return list(read_frames(path, ReadSettings(thin_m=0.0, **settings), report)), report


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


CLOCKS = {
    "back an hour": (
        lambda rows: moved(rows, -HOUR, 20),
        "set once, furthest 60 minutes back at image 20",
    ),
    "back an hour early": (lambda rows: moved(rows, -HOUR, 4), "60 minutes back at image 4"),
    "back and ahead again": (
        lambda rows: moved(rows, -HOUR, 10, 20),
        "60 minutes back at image 10",
    ),
    "back three seconds": (lambda rows: moved(rows, -3 * SECOND, 16), "3.0 s back at image 16"),
    "back, headers sound": (lambda rows: moved(rows, -HOUR, 16, header=False), "clock of the log"),
    "headers back": (
        lambda rows: moved(rows, -HOUR, 20, log=False),
        "12 of 32 header times of /camera/image",
    ),
    "the camera's headers back": (
        lambda rows: moved(rows, -HOUR, 20, log=False, topics=("/camera/image",)),
        "12 of 32 header times of /camera/image are off, furthest 60 minutes back",
    ),
    "first messages a year ahead": (lambda rows: moved(rows, YEAR, 0, 1), "4 messages are logged"),
    "first image a year ahead": (
        lambda rows: moved(rows, YEAR, 0, 1, ("/camera/image",)),
        "1 messages are logged at a time far from all others",
    ),
    "last messages a year ahead": (
        lambda rows: moved(rows, YEAR, COUNT - 1),
        "4 messages are logged",
    ),
    "an image a year back": (
        lambda rows: moved(rows, -YEAR, 9, 10, ("/camera/image",)),
        "1 messages",
    ),
    "one image header a year ahead": (
        lambda rows: moved(rows, YEAR, 9, 10, ("/camera/image",), log=False),
        "1 of 32 header times of /camera/image are off, furthest 365 days ahead",
    ),
    "first image header a year back": (
        lambda rows: moved(rows, -YEAR, 0, 1, ("/camera/image",), log=False),
        "1 of 32 header times of /camera/image are off, furthest 365 days back",
    ),
    "one pose header five seconds ahead": (
        lambda rows: moved(rows, 5 * SECOND, 9, 10, ("/pose",), log=False),
        "1 of 32 header times of /pose are off, furthest 5.0 s ahead",
    ),
    "one fix header a year ahead": (
        lambda rows: moved(rows, YEAR, 9, 10, ("/gps",), log=False),
        "1 of 32 header times of /gps",
    ),
}
ORDERS = {
    "reversed": lambda rows: rows[::-1],
    "halves exchanged": lambda rows: rows[64:] + rows[:64],
    "parts shuffled": lambda rows: [
        row for k in (3, 0, 2, 1) for row in rows[len(rows) // 4 * k : len(rows) // 4 * (k + 1)]
    ],
}


@pytest.mark.parametrize("without", [(), ("/gps",), ("/pose",)])
@pytest.mark.parametrize("attack", sorted(CLOCKS))
def test_a_wrong_clock_costs_no_image_no_pose_and_is_told(new_log, attack, without):
    change, words = CLOCKS[attack]
    rows = messages(without)
    sound, _ = read(write(new_log, rows))
    frames, report = read(write(new_log, change(rows), name="attacked.mcap"))
    assert told(frames) == told(sound)
    assert {f.status for f in frames} == {"used"}
    seconds = np.diff([f.time_ns for f in frames]) / 1e9
    assert (seconds > 0.05).all()
    assert (seconds < 0.8).all()
    affected = {"one pose": "/pose", "one fix": "/gps"}.get(attack[:8].strip())
    if affected not in without:
        count = words.replace("4 messages", f"{4 - len(without)} messages")
        assert any(count in note for note in report.notes), report.notes


@pytest.mark.parametrize("without", [(), ("/pose",)])
@pytest.mark.parametrize("packing", [{}, {"use_chunking": False}])
@pytest.mark.parametrize("order", sorted(ORDERS))
def test_messages_in_another_order_give_the_frames_of_the_sound_log(
    new_log, order, packing, without
):
    rows = messages(without)
    sound, _ = read(write(new_log, rows))
    frames, report = read(write(new_log, ORDERS[order](rows), name="attacked.mcap", **packing))
    assert told(frames) == told(sound)
    assert [f.time_ns for f in frames] == [f.time_ns for f in sound]
    assert any("another order" in note for note in report.notes)
    assert report.bytes_read == report.bytes_total
    assert report.messages == len(rows)
    assert not report.lost


@pytest.mark.parametrize("seed", range(4))
def test_messages_late_within_a_window_give_the_same_frames(new_log, seed):
    draw = random.Random(seed)
    rows = messages()
    sound, _ = read(write(new_log, rows))
    mixed = sorted(rows, key=lambda row: row[3] + draw.randrange(SECOND))
    frames, report = read(write(new_log, mixed, name="attacked.mcap"))
    assert [replace(f, data=bytes(f.data), pose=None) for f in frames] == [
        replace(f, data=bytes(f.data), pose=None) for f in sound
    ]
    for one, other in zip(frames, sound, strict=True):
        assert (one.pose.pose.centre == other.pose.pose.centre).all()
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


def test_an_image_without_pose_and_poses_for_a_part_only_lose_no_image_behind_the_first(new_log):
    rows = messages(("/gps",))
    for keep, unused in ((range(8, COUNT), 8), (range(16), 0), (set(range(COUNT)) - {9}, 0)):
        some = [row for row in rows if row[0] != "/pose" or row[1] in keep]
        frames, report = read(write(new_log, some, name=f"{unused}.mcap"))
        assert [f.status for f in frames] == ["no_position"] * unused + ["used"] * (COUNT - unused)
        told = [n for n in report.notes if "before the first pose or fix are left out" in n]
        assert [n.split()[0] for n in told] == [str(unused)] * (unused > 0)
        frames, _ = read(write(new_log, some, name=f"{unused}.mcap"), spacing_m=8.0)
        assert {f.status for f in frames} == {"used"}
        assert all(f.spacing_m == 8.0 for f in frames[1:])


@given(
    st.lists(st.integers(1, 1000), min_size=2, max_size=60),
    st.integers(0, 10**6),
    st.lists(st.integers(0, 59), max_size=3),
)
def test_sound_times_are_left_as_they_are(steps, offset, images):
    log = np.cumsum(np.array(steps, np.int64)) * 10**6 + 10**12
    rows = np.unique(np.array([i for i in images if i < len(log)], np.int64))
    clock = settle_log(log, rows, log[rows] + offset, ReadSettings(late_s=1.0))
    assert (clock.time_ns == log).all()
    assert not clock.by_time
    assert not clock.jumps
    assert not clock.strays.any()
    time, wrong, _ = settle_headers(log, log + offset, 10**9)
    assert (time == log + offset).all()
    assert not wrong.any()


@given(
    st.lists(st.integers(50, 900), min_size=12, max_size=60),
    st.data(),
    st.integers(100, 10**6).map(lambda s: s * 10**9),
)
def test_a_clock_set_back_anywhere_leaves_order_and_short_steps(steps, data, size):
    log = np.cumsum(np.array(steps, np.int64)) * 10**6 + 10**16
    at = data.draw(st.integers(1, len(log) - 1))
    rows = np.arange(len(log))
    set_back = np.where(rows >= at, log - size, log)
    clock = settle_log(set_back, rows, np.zeros(len(log), np.int64), ReadSettings())
    assert not clock.by_time
    passed = np.diff(clock.time_ns)
    assert (passed >= -15 * 10**8).all()
    assert (passed < 2 * 10**9).all()


TIMES = st.one_of(st.sampled_from([0, 1, LATEST_NS - 1]), st.integers(0, LATEST_NS - 1))


@given(st.lists(st.tuples(TIMES, TIMES), min_size=1, max_size=60))
def test_times_of_any_size_are_settled(pairs):
    log_ns, header_ns = np.repeat(np.array(pairs, np.int64), 3, axis=0).T
    settings = ReadSettings(late_s=1.0, far_s=3600.0)
    clock = settle_log(log_ns, np.arange(0, len(log_ns), 2), header_ns[::2], settings)
    times, _, _ = settle_headers(clock.time_ns, header_ns, SECOND)
    assert len(clock.time_ns) == len(times) == len(log_ns)


def test_a_log_that_is_read_in_another_order_is_bounded_in_all(new_log, monkeypatch):
    path = write(new_log, ORDERS["reversed"](messages()), chunk_size=20_000)
    survey = survey_log(path)
    count = len(survey.stamps.offset)
    backwards = np.arange(count)[::-1]
    one_by_one = list(messages_of(survey, backwards, ScanReport(), Allowance()))
    assert [number for number, _ in one_by_one] == backwards.tolist()
    monkeypatch.setattr(replay, "_MOST_KEPT_BYTES", 0)
    halves = np.arange(count).reshape(2, -1).T.ravel()  # each message is in another chunk
    with pytest.raises(InputError, match=r"in the order of their times.*mcap sort"):
        list(messages_of(survey, halves, ScanReport(), Allowance(ratio=1, extra_bytes=0)))


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_of_a_log_that_is_still_written_the_messages_are_used_that_stood_there(new_log, share):
    path = write(new_log, messages())
    content = path.read_bytes()
    front = content[: int(share * len(content))]
    path.write_bytes(front)
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
    content[100] ^= 0xFF  # in the first chunk, whose messages are lost with it
    path.write_bytes(content)
    with pytest.raises(InputError, match="leave the log alone"):
        list(frames)


def test_information_tells_of_clocks_before_anything_is_run(new_log):
    path = write(new_log, moved(messages(), -HOUR, 20))
    text = format_information(describe_log(path))
    assert "note: the clock of the log is set once, furthest 60 minutes back at image 20" in text
    assert "can be used: wayside run" in text


@pytest.mark.parametrize("pause", [2 * 60 * SECOND, 45 * 60 * SECOND])
def test_a_message_long_before_or_after_all_others_in_order_is_no_fault(new_log, pause):
    rows = messages()
    early = [(*rows[0][:2], rows[0][2] - pause, rows[0][3] - pause), *rows[1:]]
    late = [*rows[:-1], (*rows[-1][:2], rows[-1][2] + pause, rows[-1][3] + pause)]
    for k, attacked in enumerate((early, late)):
        frames, report = read(write(new_log, attacked, name=f"{k}.mcap"))
        assert report.notes == []
        assert all(f.time_ns == f.header_time_ns for f in frames)


def test_an_image_just_before_the_first_pose_waits_for_the_second_one(new_log):
    rows = [
        (t, i, h - 6_000_000 if t == "/camera/image" else h, at)
        for t, i, h, at in messages(("/gps",))
    ]
    frames, _ = read(write(new_log, rows))
    assert frames[0].pose.pose.centre[0] == pytest.approx(-0.192, abs=1e-6)
