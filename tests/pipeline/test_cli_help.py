"""The command line as it explains itself: help, completion, statuses; and without Rerun."""

import os
import subprocess
import sys

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from wayside.pipeline import cli
from wayside.pipeline.cli.help import PANELS

COMMANDS = sorted(get_command(cli.app).commands)


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help_has_a_short_name_and_fits_into_80_columns(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERMINAL_WIDTH", "80")
    words = [] if command is None else [command]
    done = CliRunner().invoke(cli.app, [*words, "-h"])
    assert done.exit_code == 0
    assert max(map(len, done.stdout.splitlines())) <= 80
    usage = next(line for line in done.stdout.splitlines() if "Usage:" in line)
    assert not set("{}") & set(usage)
    if command in (None, "run"):
        said = " ".join(done.stdout.split())
        for status in ("0 done", "1 a fault", "2 wrong", "3 the input", "4 done, but", "130 "):
            assert status in said
    if command is None:
        assert "--install-completion" in done.stdout


def test_every_command_stands_under_one_heading_and_flags_show_no_type(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    listed = [name for names in PANELS.values() for name in names]
    assert sorted(listed) == COMMANDS
    said = CliRunner().invoke(cli.app, ["-h"]).stdout
    shown = [line.split()[1] for line in said.splitlines() if line.startswith("│ ")]
    assert [name for name in shown if name in listed] == listed
    for words in ([], ["run"], ["fleet"], ["fleet", "run"]):
        assert "<bool>" not in CliRunner().invoke(cli.app, [*words, "-h"]).stdout


def test_examples_stand_one_a_line(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    lines = [
        line.strip() for line in CliRunner().invoke(cli.app, ["run", "-h"]).stdout.splitlines()
    ]
    assert "• wayside run drive.mcap --view file -o out" in lines
    assert "• 4 done, but parts of the input were lost" in lines


@pytest.mark.parametrize(
    "line",
    [
        ["--debug", "info", "none.mcap"],
        ["info", "--debug", "none.mcap"],
        ["info", "none.mcap", "--debug"],
    ],
)
def test_debug_may_stand_anywhere(line, command):
    done = command(*line)
    assert done.returncode == 3
    assert "Traceback" in done.stderr
    assert "none.mcap: the log cannot be read" in done.stderr


def python(code, *words, **env):
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        env=os.environ | env,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_a_shell_completes_commands():
    code = "import sys; sys.argv[0] = 'wayside'; from wayside.pipeline.cli import main; main()"
    asked = {"_WAYSIDE_COMPLETE": "complete_bash", "COMP_WORDS": "wayside ev", "COMP_CWORD": "1"}
    done = python(code, **asked)
    assert sorted(done.stdout.split()) == ["evaluate", "evidence"]


def test_without_rerun_everything_but_the_viewer_is_there(tmp_path):
    code = (
        "import sys; sys.modules['rerun'] = None\n"
        "import wayside.pipeline.running.run, wayside.pipeline.cli.summary, wayside.pipeline.evidence.write\n"
        "import wayside.pipeline.evaluation, wayside.pipeline.labelling.page, wayside.pipeline.fitting.command\n"
        "import wayside.pipeline.logs.importing, wayside.pipeline.logs.joining, wayside.pipeline.simulation.simulate\n"
        "from wayside.pipeline.cli import main\n"
        "def status(*words):\n"
        "    sys.argv[1:] = words\n"
        "    try: main()\n"
        "    except SystemExit as end: return end.code\n"
        "roc = ('roc', 'drive.mcap', '--truth', 'drive.truth.json', '-o', sys.argv[1])\n"
        "print(status('view', sys.argv[1]), status(*roc))"
    )
    done = python(code, str(tmp_path))
    assert done.stdout.split() == ["2", "2"], done.stderr
    assert done.stderr.count("pip install 'rerun-sdk") == 2
    assert "Traceback" not in done.stderr
