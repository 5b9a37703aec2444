"""What a terminal shows of work under way, and what a pipe does not."""

import io
import re
import sys
import time

import pytest

from wayside.pipeline.cli import progress as module
from wayside.pipeline.cli.progress import COMPILING, FrameProgress, SheetProgress
from wayside.pipeline.running.run import Run

NAME = "rosbag2_2026_03_14-15_09_26_front_camera.mcap"


@pytest.fixture
def terminal(monkeypatch):
    """Make standard error a terminal of 80 columns; what is written to it."""
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")

    def become():
        screen = io.StringIO()
        monkeypatch.setattr(sys, "stderr", screen)
        return screen

    return become


def last_line(screen):
    lines = re.split(r"[\r\n]", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.getvalue()))
    return [line for line in lines if line.strip()][-1]


def test_the_bar_counts_images_looked_at_and_settled_and_ends_with_the_last_settled(terminal):
    screen, run = terminal(), Run()
    with FrameProgress(NAME, run) as progress:
        run.report.images_held, run.report.bytes_read, run.report.bytes_total = 120_000, 9, 9
        for looked_at in (40_000, 80_000, 120_000):  # all, before half of them are settled
            run.counts.looked_at = looked_at
            progress._bar.refresh()
            time.sleep(0.02)
        line = last_line(screen)
        assert "120000 searched, 0 of 120000 done" in line
        assert line.startswith("rosbag2")
        assert len(line) <= 80
        task = progress._bar.tasks[0]
        for active, words in ((True, COMPILING), (False, task.description)):
            progress.compiling(active)
            assert task.description == words
        assert task.percentage == 50
        assert task.time_remaining > 0
        run.counts.settled = 120_000
        progress._bar.refresh()
        assert task.finished
        assert "left" not in last_line(screen)


def test_the_time_goes_on_where_counting_begins_again(terminal, monkeypatch):
    """Of several simulations of as many images each."""
    screen, now = terminal(), [100.0]
    with SheetProgress("simulated", "images") as progress:
        monkeypatch.setattr(progress._bar, "get_time", lambda: now[0])
        monkeypatch.setattr(progress._bar.tasks[0], "_get_time", lambda: now[0])
        progress._bar.reset(progress._task)
        for seconds, done in ((3.0, 183), (28.0, 40), (31.0, 183)):
            now[0] = 100.0 + seconds
            progress.watch(done, 183)
            progress._bar.refresh()
            assert f"{done}/183 images 0:00:{seconds:02.0f}" in last_line(screen)


@pytest.fixture
def pipe(monkeypatch, capsys):
    """Make standard error no terminal; returns what has been written to it."""
    monkeypatch.delenv("TTY_COMPATIBLE", raising=False)
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    return lambda: capsys.readouterr().err


def test_where_no_bar_is_shown_compilation_is_told_once_and_nothing_else(pipe):
    with FrameProgress("a.mcap", Run()) as progress:
        for active in (True, False, True, False):
            progress.compiling(active)
    assert pipe() == f"wayside: {COMPILING}, takes less than a minute\n"


def test_where_no_bar_is_shown_a_line_now_and_then_says_how_far_the_work_is(pipe, monkeypatch):
    monkeypatch.setattr(module, "_TOLD_S", 0.05)
    run = Run()
    with FrameProgress("a.mcap", run), SheetProgress("evidence") as sheets:
        run.report.images_held, run.counts.looked_at, run.counts.settled = 24, 12, 3
        sheets.watch(7, 20)
        time.sleep(0.5)
    said = pipe()
    assert "a.mcap 12 searched, 3 of 24 done\n" in said
    assert re.search(r"(?m)^evidence 7/20 sheets 0:00:00$", said)
    time.sleep(0.2)
    assert not pipe()
