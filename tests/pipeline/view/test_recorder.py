"""A sink that is slow, full or broken must leave the run alone."""

import threading
import time

import pytest
import rerun as rr

from wayside.pipeline.view import observer
from wayside.pipeline.view.entities import Batch, Entity, Times
from wayside.pipeline.view.observer import WAITING, Recorder

BATCH = Batch(Times(0, 0, 0, 0.0), (Entity("words", rr.TextLog("hello")),))


class Blocking:
    """Takes its time."""

    def __init__(self):
        self.go = threading.Event()

    def send(self, stream):
        self.go.wait(10)


def memory():
    return rr.RecordingStream("test", recording_id="test")


def test_what_is_put_is_in_the_file(tmp_path):
    path = tmp_path / "a.rrd"

    def opened():
        stream = memory()
        stream.save(path)
        return stream

    one = Recorder("a.rrd", opened, 5.0)
    for _ in range(3):
        one.put([BATCH])
    one.close()
    assert one.fault is None
    found = [c for c in rr.chunk.RrdReader(str(path)).stream() if c.entity_path == "/words"]
    assert sum(c.num_rows for c in found) == 3


def test_a_live_viewer_that_is_too_slow_misses_frames_and_costs_no_time(tmp_path):
    slow = Blocking()
    one = Recorder("viewer", memory, 0.0)
    for _ in range(WAITING + 10):
        one.put([slow])
    slow.go.set()
    one.close()
    assert one.dropped >= 9
    assert one.fault is None


def test_a_file_that_takes_nothing_is_given_up():
    stuck = Blocking()
    one = Recorder("file", memory, 0.05)
    for _ in range(WAITING + 3):
        one.put([stuck])
    assert one.fault == "accepted no data for 0.05 s"
    stuck.go.set()
    one.close()


def test_a_sink_that_never_answers_is_left_behind(monkeypatch):
    monkeypatch.setattr(observer, "PATIENCE_S", 0.1)
    stuck = Blocking()
    one = Recorder("viewer", memory, 0.0)
    one.put([stuck])
    one.close()
    assert one.fault == "did not end within 0.1 s"
    stuck.go.set()


@pytest.mark.parametrize("when", ["opened", "sent"])
def test_a_fault_is_kept_and_the_rest_is_let_go(when, tmp_path):
    class Broken:
        def send(self, stream):
            raise ValueError("no such shape\nat all")

    def absent():
        raise RuntimeError("no such folder")

    one = Recorder("file", absent if when == "opened" else memory, 5.0)
    one.put([Broken()])
    until = time.monotonic() + 5
    while one.fault is None and time.monotonic() < until:
        time.sleep(0.01)
    for _ in range(3 * WAITING):
        one.put([BATCH])
    one.close()
    assert one.fault in ("RuntimeError: no such folder", "ValueError: no such shape")
