"""A set of files replaces the earlier one all at once, whenever the writer is killed."""

import os
import signal
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from wayside.pipeline.files import output_folder
from wayside.pipeline.files.output_folder import (
    DONE,
    LOCK,
    RECORDING,
    OutputFolder,
    finish_replacement,
)
from wayside.pipeline.files.writing import PART
from wayside.schemas.errors import InputError, OutputError

NAMES = ("a.parquet", "b.parquet", "c.json")


def write(folder, word, names=NAMES, **options):
    with OutputFolder(folder) as output:
        for name in names:
            (output.part / name).write_text(word)
        output.commit(**options)


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


def whole(word, names=NAMES):
    return dict.fromkeys(names, word)


def test_files_appear_together_and_those_of_others_stay(tmp_path):
    out = tmp_path / "deep" / "out"
    write(out, "new")
    (out / "notes.txt").write_text("mine")
    write(out, "next")
    assert contents(out) == {**whole("next"), "notes.txt": "mine"}
    assert sorted(os.listdir(out)) == sorted([*NAMES, "notes.txt"])


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, OutputError, OSError])
def test_an_error_before_the_commit_leaves_what_was_there(tmp_path, error):
    def fail(folder):
        with OutputFolder(folder) as output:
            (output.part / NAMES[0]).write_text("new")
            raise error("no more")

    write(tmp_path / "old", "old")
    for name in ("old", "none"):
        with pytest.raises(error):
            fail(tmp_path / name)
    assert contents(tmp_path / "old") == whole("old")
    assert sorted(os.listdir(tmp_path / "old")) == sorted(NAMES)
    assert os.listdir(tmp_path) == ["old"]


def killed(work, at):
    """Do some work in a process that dies before call number `at` of those that change the disk."""
    child = os.fork()
    if child:
        os.waitpid(child, 0)
        return
    count = iter(range(10**6))

    def guarded(module, name):
        call = getattr(module, name)

        def counted(*args, **kwargs):
            if next(count) == at:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*args, **kwargs)

        setattr(module, name, counted)

    for name in ("replace", "rename", "unlink", "mkdir", "rmdir", "open", "fsync"):
        guarded(os, name)
    try:
        work()
    finally:
        os._exit(0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0, 60), again=st.integers(0, 30))
def test_a_kill_at_any_step_leaves_the_old_result_or_the_new(tmp_path_factory, at, again):
    """Also a kill while the next command finishes the replacement."""
    folder = tmp_path_factory.mktemp("out")
    write(folder, "old")
    (folder / RECORDING).write_text("old")
    killed(lambda: write(folder, "new", drop=[RECORDING]), at)
    killed(lambda: finish_replacement(folder), again)
    finish_replacement(folder)
    found = {name: text for name, text in contents(folder).items() if name != LOCK}
    assert found in ({**whole("old"), RECORDING: "old"}, whole("new"))
    write(folder, "next")
    assert {k: v for k, v in contents(folder).items() if k != RECORDING} == whole("next")
    assert not {PART, DONE, LOCK} & set(os.listdir(folder))


def test_an_interrupt_in_the_middle_of_the_moves_completes_them(tmp_path, monkeypatch):
    write(tmp_path, "old")
    replace, calls = os.replace, []

    def interrupted(*args):
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt
        replace(*args)

    monkeypatch.setattr(output_folder.os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path, "new")
    assert contents(tmp_path) == whole("new")
    assert sorted(os.listdir(tmp_path)) == sorted(NAMES)


def test_the_lock_of_a_killed_process_does_not_count(tmp_path):
    code = (
        "import sys, time\nfrom pathlib import Path\n"
        "from wayside.pipeline.files.output_folder import OutputFolder\n"
        "with OutputFolder(Path(sys.argv[1])) as output:\n"
        "    (output.part / 'a.parquet').write_text('half')\n"
        "    print('there', flush=True)\n    time.sleep(60)\n"
    )
    line = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(line, stdout=subprocess.PIPE) as writer:
        writer.stdout.readline()
        with pytest.raises(OutputError, match="another wayside"):
            write(tmp_path, "new")
        writer.send_signal(signal.SIGKILL)
    write(tmp_path, "new")
    assert contents(tmp_path) == whole("new")


@pytest.mark.parametrize("name", [PART, DONE, LOCK])
def test_links_in_the_place_of_scratch_files_are_not_followed(tmp_path, name):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "precious").write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to(elsewhere / "precious" if name == LOCK else elsewhere)
    if name == LOCK:
        with pytest.raises(OutputError):
            write(out, "new")
    else:
        write(out, "new")
        finish_replacement(out)
        assert contents(out) == whole("new")
    assert contents(elsewhere) == {"precious": "mine"}


@pytest.mark.parametrize("content", ['[["../precious"], false]', '[[".x"], false]', "{", "3"])
def test_a_list_of_files_that_leads_elsewhere_is_refused(tmp_path, content):
    (tmp_path / "precious").write_text("mine")
    out = tmp_path / "out"
    (out / DONE).mkdir(parents=True)
    (out / DONE / ".files.json").write_text(content)
    (out / DONE / "precious").write_text("other")
    with pytest.raises(InputError, match="has not replaced the old one"):
        finish_replacement(out)
    assert (tmp_path / "precious").read_text() == "mine"


def test_a_folder_of_the_name_of_a_file_is_named_and_nothing_changes(tmp_path):
    write(tmp_path, "old", NAMES[:2])
    (tmp_path / NAMES[2]).mkdir()
    with pytest.raises(OutputError, match="a folder has the name"):
        write(tmp_path, "new")
    assert contents(tmp_path) == whole("old", NAMES[:2])


def test_readers_wait_for_a_replacement_under_way(tmp_path, monkeypatch):
    write(tmp_path, "old")
    with OutputFolder(tmp_path):
        (tmp_path / DONE).mkdir()
        monkeypatch.setattr(output_folder, "_PATIENCE_S", 0.05)
        with pytest.raises(InputError, match="is replacing the result"):
            finish_replacement(tmp_path)
