"""What comes from a log or a name is shown as it is and acts on nothing."""

import io
import os
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from rich.console import Console

from wayside.pipeline.cli.progress import FrameProgress
from wayside.pipeline.cli.summary import plain, sign_table
from wayside.pipeline.files.visible_text import fitted, visible, visible_lines
from wayside.pipeline.reading.plan import describe_cameras
from wayside.pipeline.running.run import Run

from .results import invoke, sign_row

NASTY = "/cam\x1b]0;owned\x07[/bold][red]\u202e\nforged: line\udcff"


@given(st.text())
def test_visible_text_is_printable_and_printable_text_is_unchanged(text):
    assert visible(text).isprintable()
    assert visible(text) == text or not text.isprintable()
    assert visible_lines("one\ntwo") == "one\ntwo"


def test_a_name_of_markup_and_commands_to_the_terminal_is_shown_as_text():
    with FrameProgress("[/bold]\x1b[2J.mcap", Run()) as progress:
        assert "\x1b" not in progress._bar.tasks[0].description
    numbers = ("station_m", "lateral_m", "up_m", "panel_width_m", "panel_height_m", "sigma_along_m")
    unknown = {"color": None, "shape": None, "confidence": 0.5}
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=200, highlight=False)
    console.print(sign_table([sign_row("[/bold]-0001", **dict.fromkeys(numbers, 1.0), **unknown)]))
    console.print(f"[bold]{plain(NASTY)}[/bold]")
    table, _, shown = screen.getvalue().rpartition("/cam")
    assert "[/bold]-0001" in table
    assert "[/bold][red]" in shown
    assert r"\x1b]0;owned\x07" in shown
    assert "\x1b]" not in shown
    assert "\nforged" not in shown


def test_topics_of_any_content_are_listed_without_acting_on_the_terminal(tmp_path):
    path = tmp_path / "drive.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="tests")
        schema = writer.register_schema("foxglove.CompressedImage\x1b[2J", "jsonschema", b"{}")
        writer.add_message(writer.register_channel(NASTY[:-1], "json", schema), 1, b"{}", 1, 1)
        writer.finish()
    shown = invoke("info", path)
    assert "\x1b" not in shown
    assert "\nforged" not in shown
    assert r"\x1b]0;owned" in shown


@pytest.mark.parametrize("words", [["info"], ["run", "-o", "out"]])
def test_a_name_that_is_not_utf8_is_named_in_the_error(tmp_path, command, words):
    done = command(*words, os.fsdecode(os.fsencode(str(tmp_path)) + b"/caf\xe9\x1b[2J.mcap"))
    assert done.returncode == 3
    assert r"caf\udce9\x1b[2J.mcap: the log cannot be read" in done.stderr


def test_thousands_of_cameras_are_named_by_a_handful():
    cameras = [
        SimpleNamespace(name=f"/camera{i}" + "x" * i, count=i, image_size=None) for i in range(3000)
    ]
    words = describe_cameras(cameras)
    assert len(words) < 1000
    assert "and 2994 more" in words


def test_lines_are_broken_for_the_terminal_and_commands_stay_whole(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    command = "  can be used: wayside run /a/rather/long/way/to/a/drive.mcap -o out"
    shown = fitted(f"  note: {'word ' * 20}\n{command}\nshort").splitlines()
    assert shown[-2:] == [command, "short"]
    assert max(map(len, shown[:-2])) <= 40
    assert all(line.startswith("      word") for line in shown[1:-2])
