from dataclasses import replace

import pytest

from wayside.pipeline.running.pace import paced
from wayside.schemas.frame import Frame

FRAME = Frame(0, 0, None, "used", "jpeg", b"", None)


class Clock:
    """Time that passes by sleeping and by working only."""

    def __init__(self):
        self.seconds, self.slept = 100.0, []

    def now(self):
        return self.seconds

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.seconds += seconds


def play(times_s, rate, work_s=0.0):
    clock = Clock()
    frames = [replace(FRAME, index=i, log_time_ns=round(t * 1e9)) for i, t in enumerate(times_s)]
    given = []
    for frame in paced(iter(frames), rate, now=clock.now, sleep=clock.sleep):
        given.append((frame.index, clock.seconds - 100.0))
        clock.seconds += work_s
    return given, clock


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_every_frame_comes_at_its_time(rate):
    given, _ = play([10.0, 10.3, 11.0], rate)
    assert [index for index, _ in given] == [0, 1, 2]
    assert [when for _, when in given] == pytest.approx([0, 0.3 / rate, 1.0 / rate])


def test_a_late_frame_goes_at_once_and_the_next_keeps_to_the_clock():
    given, clock = play([0.0, 0.1, 0.2, 2.0], 1.0, work_s=0.5)
    assert [when for _, when in given] == pytest.approx([0, 0.5, 1.0, 2.0])
    assert clock.slept == pytest.approx([0.5])
