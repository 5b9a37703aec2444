"""The command line as it explains itself: help, completion, statuses; and without Rerun."""

import re

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from wayside.pipeline import cli

COMMANDS = sorted(get_command(cli.app).commands)


def help_of(*words):
    done = CliRunner().invoke(
        cli.app, [*words, "-h"], env={"COLUMNS": "80", "TERMINAL_WIDTH": "80"}
    )
    assert done.exit_code == 0
    return done.stdout


@pytest.mark.parametrize("words", [[], *([name] for name in COMMANDS), ["fleet", "run"]])
def test_help_has_a_short_name_and_fits_into_80_columns(words):
    said = help_of(*words)
    assert max(map(len, said.splitlines())) <= 80
    assert not set("{}") & set(next(line for line in said.splitlines() if "Usage:" in line))
    assert "<bool>" not in said
    if words in ([], ["run"]):
        for status in ("0 done", "1 an inter", "2 wrong", "3 the input", "4 done, but", "130 "):
            assert f"• {status}" in said
    if not words:
        shown = re.findall(r"(?m)^(?:│|╭─) ([A-Za-z][\w -]*?)(?=  | ─)", said)
        headings = ["A drive", "Its result", "Many drives", "Your own roads"]
        assert [one for one in shown if one in headings] == headings
        assert {*COMMANDS} <= {*shown}
        assert "--install-completion" in said
    if words == ["run"]:
        examples = [line.strip() for line in said.splitlines()]
        assert "• wayside run drive.mcap --view file -o out" in examples


@pytest.mark.parametrize("place", range(3))
def test_debug_may_stand_anywhere(place, command):
    line = ["info", "none.mcap"]
    line.insert(place, "--debug")
    done = command(*line)
    assert done.returncode == 3
    assert "Traceback" in done.stderr
    assert "none.mcap: the log cannot be read" in done.stderr


def test_a_shell_completes_commands(python):
    code = "import sys; sys.argv[0] = 'wayside'; from wayside.pipeline.cli import main; main()"
    asked = {"_WAYSIDE_COMPLETE": "complete_bash", "COMP_WORDS": "wayside ev", "COMP_CWORD": "1"}
    assert sorted(python(code, **asked).stdout.split()) == ["evaluate", "evidence"]


def test_arrays_of_arrow_load_no_pandas(python):
    code = (
        "import sys; from wayside.pipeline.cli import main\n"
        "try: main()\n"
        "finally: import pyarrow; pyarrow.array([1]); print(*sys.modules)"
    )
    loaded = python(code, "--version").stdout.split()
    assert "pyarrow" in loaded
    assert "pandas" not in loaded


def test_without_rerun_everything_but_the_viewer_is_there(python, tmp_path):
    code = (
        "import sys; sys.modules['rerun'] = None\n"
        "import wayside.pipeline.running.run, wayside.pipeline.cli.summary, wayside.pipeline.evidence.write\n"
        "import wayside.pipeline.evaluation.compare, wayside.pipeline.labelling.page\n"
        "import wayside.pipeline.fitting.command\n"
        "import wayside.pipeline.logs.importing, wayside.pipeline.logs.joining, wayside.pipeline.simulation.simulate\n"
        "from wayside.pipeline.cli import main\n"
        "def status(*words):\n"
        "    sys.argv[1:] = words\n"
        "    try: main()\n"
        "    except SystemExit as end: return end.code\n"
        "roc = ('roc', 'drive.mcap', '--truth', 'drive.truth.json', '-o', sys.argv[1])\n"
        "print(status('view', sys.argv[1]), status(*roc))"
    )
    done = python(code, tmp_path)
    assert done.stdout.split() == ["2", "2"], done.stderr
    assert done.stderr.count("pip install 'rerun-sdk") == 2
    assert "Traceback" not in done.stderr
