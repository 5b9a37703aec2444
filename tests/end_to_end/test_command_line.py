"""The command as a person calls it: each exit status, with the words that come with it.

Where the process itself matters, as the installed program; else by its entry point.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from wayside.pipeline import chains

from .conftest import altered_demo

WAYSIDE = Path(sys.executable).with_name("wayside")
DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
SHORT = ("--until", "0.7s")
TABLES = {"signs.parquet", "observations.parquet", "frames.parquet"}


def files_in(folder):
    return {path.name for path in folder.iterdir()} if folder.exists() else set()


def program(*arguments, **env):
    """Runs the installed program."""
    line, env = [WAYSIDE, *arguments], os.environ | env
    return subprocess.run(line, capture_output=True, env=env, timeout=300, check=False)


def test_0_a_run_that_is_done_says_what_it_found_in_the_characters_of_the_terminal(tmp_path):
    log, out = tmp_path / "learn_alley.mcap", tmp_path / "Bögen"
    log.symlink_to(DEMO)
    done = program("run", log, *SHORT, "-o", out, PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert b"3 used, 21 outside" in done.stdout
    assert b"+-along m" in done.stdout
    assert b"B?gen" in done.stdout
    assert files_in(out) == {*TABLES, "run.json"}
    # a log of that name is among those that the models say they were learned from
    assert "location" in json.loads((out / "run.json").read_text())["learned_from_log"]


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["cp1252", "utf-8"])
def test_output_keeps_the_characters_that_the_terminal_has(tmp_path, encoding):
    done = program("run", DEMO, *SHORT, "-o", tmp_path / "Bögen", PYTHONIOENCODING=encoding)
    assert "±along m".encode(encoding) in done.stdout
    assert "Bögen".encode(encoding) in done.stdout
    done = program("info", tmp_path / "Bögen.mcap", PYTHONIOENCODING=encoding)
    assert done.returncode == 3
    assert "Bögen.mcap".encode(encoding) in done.stderr


def test_1_a_fault_of_wayside_names_the_stage_and_the_frame(command, tmp_path, monkeypatch):
    def decode(frames, *options):
        for frame in frames:
            raise RuntimeError("made up")
            yield frame

    monkeypatch.setattr(chains, "decode", decode)
    done = command("run", DEMO, *SHORT, "-o", tmp_path / "out")
    assert done.returncode == 1
    assert "wayside: stage decode failed" in done.stderr
    assert "RuntimeError: made up" in done.stderr
    assert not files_in(tmp_path / "out") & TABLES


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run",), "missing: LOG..., --out. --help"),
        (("changes", "inventory", "--after", "2025"), "missing: --before, --out."),
        (("run", DEMO, "-o", "out", "--preset", "best"), "'best' is not one of"),
        (("run", DEMO, "-o", "out", "--set", "segment.clusters=many"), "segment.clusters"),
        (("run", DEMO, "-o", "out", "--spacing", "8 parsecs"), "8 parsecs"),
    ],
)
def test_2_wrong_arguments_are_named(command, arguments, words):
    done = command(*arguments)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_3_an_input_that_cannot_be_used_is_named(command, tmp_path):
    text = tmp_path / "notes.mcap"
    text.write_text("not a log")
    for log, words in ((tmp_path / "absent.mcap", "No such file"), (text, "notes.mcap")):
        done = command("run", log, "-o", tmp_path / "out")
        assert done.returncode == 3
        assert done.stderr.startswith(f"wayside: {log}")
        assert words in done.stderr
        assert "Traceback" not in done.stderr
        assert not files_in(tmp_path / "out")


def test_4_a_damaged_log_gives_what_can_be_read_and_says_what_is_lost(command, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(DEMO.read_bytes()[:1_500_000])
    done = command("run", cut, *SHORT, "-o", tmp_path / "out")
    assert done.returncode == 4, done.stderr
    assert "lost:" in done.stdout
    assert files_in(tmp_path / "out") == {*TABLES, "run.json"}


def test_4_images_of_another_size_than_their_calibration_are_lost_and_said_so(command, tmp_path):
    seen = []

    def third_halved(image):
        seen.append(image)
        return image[::2, ::2] if len(seen) == 3 else image

    log = altered_demo(tmp_path / "sizes.mcap", third_halved, most=None)
    done = command("run", log, *SHORT, "-o", tmp_path / "out")
    assert done.returncode == 4, done.stderr
    assert "2 used, 21 outside, 1 wrong_size" in done.stdout
    assert "1 image of another size than the calibration" in done.stdout


def test_5_a_folder_that_cannot_be_written_is_named(command, tmp_path):
    file = tmp_path / "file"
    file.write_text("in the way")
    done = command("run", DEMO, "-o", file / "out")
    assert done.returncode == 5
    assert f"wayside: {file / 'out'}: the result cannot be written" in done.stderr
    assert "Choose another folder with -o" in done.stderr
    assert file.read_text() == "in the way"


def test_130_an_interrupted_run_says_so_and_leaves_no_table(tmp_path):
    out = tmp_path / "out"
    line = [WAYSIDE, "run", str(DEMO), "-o", str(out)]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    running = subprocess.Popen(line, **pipes, start_new_session=True)
    deadline = time.monotonic() + 120
    while not files_in(out) and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(running.pid, signal.SIGINT)
    _, words = running.communicate(timeout=120)
    assert running.returncode == 130, words
    assert "wayside: interrupted; this log's tables were not written" in words
    assert not files_in(out) & TABLES


@pytest.mark.parametrize(
    "words",
    [["info"], ["run", DEMO, "--settings"], ["export"], ["evaluate", "--truth", "t.json"]],
    ids=["log", "settings", "result of export", "result of evaluate"],
)
def test_a_path_that_names_no_file_or_folder_is_refused_at_once(command, tmp_path, words):
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    out = [] if words[0] in ("info", "evaluate") else ["-o", str(tmp_path / "out.csv")]
    for path in ("pipe", "loop", "x" * 5000, "file/x"):
        done = command(*words, tmp_path / path, *out)
        assert done.returncode in (2, 3)
        assert "wayside: " in done.stderr
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize("logs", [["a.mcap"], ["a.mcap", "b.mcap"]])
def test_3_a_log_in_a_folder_that_cannot_be_searched_is_told(command, monkeypatch, tmp_path, logs):
    stat = os.stat

    def closed(path, *rest, **more):
        if "closed" in str(path):
            raise PermissionError(13, "Permission denied", str(path))
        return stat(path, *rest, **more)

    monkeypatch.setattr(os, "stat", closed)
    done = command("run", *(f"closed/{log}" for log in logs), "-o", tmp_path)
    assert done.returncode == 3
    assert done.stderr.count("cannot be read: Permission denied") == len(logs)
