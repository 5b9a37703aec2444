"""What the machine does to a run: signals, closed pipes, full disks, two runs at once; and files of the user."""

import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from wayside.pipeline.cli import app
from wayside.pipeline.running import run as run_module
from wayside.pipeline.running.journal import JOURNAL

from ..conftest import small_disk

WAYSIDE = Path(sys.executable).with_name("wayside")
DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
SHORT = ("--until", "0.7s")
TABLES = ("frames.parquet", "observations.parquet", "signs.parquet")
FILES = [*TABLES, "run.json"]


def run(out, *options, until=SHORT):
    line = [WAYSIDE, "run", DEMO, *until, "-o", out, *options]
    told = {"capture_output": True, "text": True, "timeout": 300, "check": False}
    return subprocess.run([str(word) for word in line], **told)


def digests(folder):
    files = (path for path in folder.iterdir() if path.is_file())
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def old(tmp_path_factory):
    """A result of the demo log."""
    folder = tmp_path_factory.mktemp("old") / "out"
    done = run(folder, until=("--until", "0.3s"))
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def out(old, tmp_path):
    """A copy of it, to be replaced."""
    shutil.copytree(old, tmp_path / "out")
    return tmp_path / "out"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_signals_that_ask_to_end_are_interrupts(out, old, number):
    line = [str(WAYSIDE), "run", str(DEMO), "-o", str(out), "--view", "file"]
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as running:
        wait_for(out / ".wayside-part" / ".observations.scratch")
        running.send_signal(number)
        _, words = running.communicate(timeout=60)
    assert running.returncode == 130
    assert b"wayside: interrupted; this log's tables were not written" in words
    assert digests(out) == digests(old)


@pytest.mark.slow
@pytest.mark.parametrize("stream", ["stdout", "stderr", "both"])
def test_a_closed_pipe_is_no_failure(tmp_path, stream):
    reader, writer = os.pipe()
    os.close(reader)
    to = {name: writer for name in ("stdout", "stderr") if stream in (name, "both")}
    line = [str(WAYSIDE), "run", str(DEMO), *SHORT, "-o", str(tmp_path / "out")]
    rest = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL} | to
    assert subprocess.run(line, check=False, timeout=300, **rest).returncode == 0
    os.close(writer)
    assert sorted(digests(tmp_path / "out")) == sorted(FILES)


def test_closed_streams_and_readers_that_go_are_no_failure():
    line = f"{WAYSIDE} settings --all | head -1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    line = f"{WAYSIDE} info {DEMO} >&- 2>&-"
    assert subprocess.run(["bash", "-c", line], check=False).returncode == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_words_that_do_not_fit_on_the_disk_are_an_output_error():
    with open("/dev/full", "w") as full:
        line = [str(WAYSIDE), "settings"]
        done = subprocess.run(line, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 5
    assert done.stderr.startswith("wayside: output: the output cannot be written: No space left")
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("free_kb", [0, 4, 8, 20, 40])
def test_a_full_disk_leaves_the_old_result(old, tmp_path, free_kb):
    size = sum(-(-path.stat().st_size // 4096) * 4 for path in old.iterdir()) + 8
    with small_disk(tmp_path / "disk", size + free_kb) as disk:
        out = disk / "out"
        shutil.copytree(old, out)
        done = run(out, "--observations", "all")
        assert done.returncode == 5
        assert "Free some space" in done.stderr
        assert "Traceback" not in done.stderr
        assert digests(out) == digests(old)
        assert sorted(os.listdir(out)) == sorted(FILES)


def wait_for(path):
    deadline = time.monotonic() + 120
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert path.exists()


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_and_gives_the_same_bytes(tmp_path):
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert run(whole, until=()).returncode == 0
    line = [str(WAYSIDE), "run", str(DEMO), "-o", str(out), "--resume"]
    for kept in (600_000, 1_500_000):  # bytes of the journal: killed twice
        with subprocess.Popen(line, stdout=subprocess.DEVNULL) as running:
            journal = out / ".wayside-journal"
            deadline = time.monotonic() + 120
            while running.poll() is None:
                if journal.exists() and journal.stat().st_size >= kept:
                    break
                assert time.monotonic() < deadline
                time.sleep(0.002)
            running.kill()
    other = run(out, "--resume", "--workers", "3", until=())
    assert other.returncode == 0, other.stderr
    assert sorted(os.listdir(out)) == sorted(FILES)
    assert [digests(out)[name] for name in TABLES] == [digests(whole)[name] for name in TABLES]
    assert json.loads((out / "run.json").read_text())["times"]["replayed_frames"] >= 4


@pytest.fixture(scope="module")
def with_journal(tmp_path_factory):
    """A result whose journal was left, and what a function of its bytes makes a run that goes on give."""
    folder = tmp_path_factory.mktemp("journal")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_module, "remove_journal", lambda folder: None)
        line = ["run", str(DEMO), *SHORT, "-o", str(folder / "whole"), "--resume"]
        assert not app(line, standalone_mode=False)
    whole = (folder / "whole" / JOURNAL).read_bytes()

    def resumed(altered):
        out = folder / "out"
        shutil.copytree(folder / "whole", out, dirs_exist_ok=True)
        (out / JOURNAL).write_bytes(altered(whole))
        assert not app([*line[:-2], str(out), "--resume"], standalone_mode=False)
        given = [digests(out)[name] for name in TABLES]
        about = json.loads((out / "run.json").read_text())
        return given == [digests(folder / "whole")[name] for name in TABLES], about

    return resumed


def test_a_run_with_its_whole_journal_takes_all_from_it(with_journal):
    same, about = with_journal(lambda whole: whole)
    assert same
    assert about["times"]["replayed_frames"] == 24
    assert not [note for note in about["notes"] if "--resume" in note]


def test_an_altered_journal_changes_no_byte_of_the_tables(with_journal):
    rng = random.Random(0)

    def altered(whole):
        content = bytearray(whole)
        for _ in range(rng.randint(1, 4)):
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        return content[: rng.choice([len(content), rng.randrange(len(content))])]

    same, about = with_journal(altered)
    assert same
    assert [note for note in about["notes"] if note.startswith("--resume")]


def test_resuming_and_viewing_exclude_each_other(command, tmp_path):
    done = command("run", DEMO, "-o", tmp_path / "out", "--resume", "--view", "file")
    assert done.returncode == 2
    assert "Leave one out" in done.stderr
