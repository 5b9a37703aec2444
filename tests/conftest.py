"""What all tests share."""

import dataclasses
import functools
import os
import subprocess
import sys
from contextlib import contextmanager
from subprocess import CompletedProcess

import numpy as np
import pytest
import typer.main
import typer.testing
from hypothesis import settings

from wayside.pipeline.cli import application

settings.register_profile("untimed", deadline=None, max_examples=50)  # a busy machine is no fault
settings.load_profile("untimed")


@pytest.fixture(scope="session", autouse=True)
def fast_disk():
    """Waits for no disk, in this process: no test takes the power away."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda opened: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def one_command_tree():
    """Makes the commands of `wayside` once: Typer makes all at every call, which takes longer than most commands."""
    made = functools.cache(typer.main.get_command)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", made)
        patch.setattr(typer.testing, "_get_command", made)
        yield


@pytest.fixture
def command(monkeypatch, capsys):
    """Calls the entry point of `wayside` with these arguments, in this process; its exit status and words."""

    def call(*arguments):
        line = ["wayside", *map(str, arguments)]
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", line)
            patch.setattr(
                application, "interrupt_on_signals", lambda: None
            )  # they stay as they are
            # other tests of this process need pandas
            patch.setattr(sys, "meta_path", [*sys.meta_path])
            patch.setattr(application.WithoutPandas, "find_spec", lambda *_: None)
            with pytest.raises(SystemExit) as end:
                application.main()
        assert isinstance(end.value.code, int)
        said = capsys.readouterr()
        return CompletedProcess(line, end.value.code, said.out, said.err)

    return call


@pytest.fixture(scope="session")
def python():
    """Runs a program with these words and variables in a process of its own, which ends with this status."""

    def run(code, *words, status=0, cwd=None, **more):
        how = {"cwd": cwd, "env": os.environ | more, "capture_output": True, "text": True}
        line = [sys.executable, "-c", code, *map(str, words)]
        done = subprocess.run(line, timeout=300, check=False, **how)
        assert done.returncode == status, done.stderr
        return done

    return run


@contextmanager
def small_disk(folder, kilobytes):
    """A file system of its own; skips where none may be mounted."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", folder]
    if os.name == "nt" or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no file system may be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def bits_of(value):
    """Bits of all numbers and arrays of a value."""
    if dataclasses.is_dataclass(value):
        return [bits_of(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, tuple | list):
        return [bits_of(one) for one in value]
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.flags.c_contiguous, value.tobytes()
    return repr(value)


@pytest.fixture(name="bits")
def _bits():
    """`bits_of`, to compare by."""
    return bits_of
