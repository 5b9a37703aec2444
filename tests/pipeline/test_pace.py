from dataclasses import replace

import pytest

from wayside.pipeline.running.flow import paced
from wayside.schemas.frame import Frame

FRAME = Frame(0, 0, None, "used", "jpeg", b"", None)


def play(times_s, rate, work_s=0.0):
    """Frame and time of each that is given, where time passes by sleeping and by working only; and the sleeps."""
    clock, slept, given = [100.0], [], []

    def sleep(seconds):
        slept.append(seconds)
        clock[0] += seconds

    frames = [replace(FRAME, index=i, log_time_ns=round(t * 1e9)) for i, t in enumerate(times_s)]
    for frame in paced(iter(frames), rate, now=lambda: clock[0], sleep=sleep):
        given.append((frame.index, clock[0] - 100.0))
        clock[0] += work_s
    return given, slept


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_every_frame_comes_at_its_time(rate):
    given, _ = play([10.0, 10.3, 11.0], rate)
    assert [index for index, _ in given] == [0, 1, 2]
    assert [when for _, when in given] == pytest.approx([0, 0.3 / rate, 1.0 / rate])


def test_a_late_frame_goes_at_once_and_the_next_keeps_to_the_clock():
    given, slept = play([0.0, 0.1, 0.2, 2.0], 1.0, work_s=0.5)
    assert [when for _, when in given] == pytest.approx([0, 0.5, 1.0, 2.0])
    assert slept == pytest.approx([0.5])
