"""Compilation of kernels in a first run: told to the user, and done by two processes."""

import gc
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import event
from numba.core.caching import NullCache

_TYPES = Path(__file__).with_name("kernel_types.json")
_AHEAD = f"import gc; gc.disable(); from {__name__} import compile_from_last; compile_from_last()"


def compiled_ahead() -> list[tuple[Any, Any]]:
    """Kernels that preset `default` calls, about in the order of use, each with the types of its arguments.

    In `kernel_types.json`, "2 float64" is an array of two dimensions, "0 float32" a number, a list a tuple,
    {"module:name": [...]} a named tuple; other numbers stand for themselves.
    """
    described = json.loads(_TYPES.read_text())
    return [(_named(name), _typed(_example(arguments))) for name, arguments in described.items()]


def compile_from_last() -> None:
    """Compile and cache the kernels of `compiled_ahead`, the last first."""
    for kernel, types in reversed(compiled_ahead()):
        kernel.compile(types)


def _named(name: str) -> Any:
    module, _, attribute = name.partition(":")
    return getattr(import_module(f"wayside.stages.{module}"), attribute)


def _typed(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(numba.typeof(argument) for argument in arguments)  # type: ignore[no-untyped-call]


def _example(described: Any) -> Any:
    """A value of a described type."""
    if isinstance(described, str):
        dimensions, _, dtype = described.partition(" ")
        return np.zeros((1,) * int(dimensions), _named(dtype) if ":" in dtype else dtype)[()]
    if isinstance(described, dict):
        ((name, fields),) = described.items()
        return _named(name)(*map(_example, fields))
    return tuple(map(_example, described)) if isinstance(described, list) else described


@contextmanager
def watched_compilation(notify: Callable[[bool], None]) -> Iterator[None]:
    """Compile kernels faster in a block, and call `notify` with True where a compilation starts, False where it ends.

    Garbage collection pauses meanwhile. The compiler makes millions of small objects that live until it is done, and
    scanning them repeatedly costs about a fifth of its time. From the first one on, another process compiles the
    kernels that come last. What one process has compiled, the other finds in the cache, until they meet.
    """
    listener = _CompilationListener(notify)
    try:
        with event.install_listener("numba:compile", listener):
            yield
    finally:
        if listener.ahead is not None:
            listener.ahead.kill()
            listener.ahead.wait()


class _CompilationListener(event.Listener):
    """Counts nested compilations; numba compiles under one lock, so there is one at a time."""

    def __init__(self, notify: Callable[[bool], None]) -> None:
        self._notify, self._depth = notify, 0
        self.ahead: subprocess.Popen[bytes] | None = None

    def on_start(self, event: event.Event) -> None:
        self._depth += 1
        if self.ahead is None and not isinstance(event.data["dispatcher"]._cache, NullCache):
            command, nowhere = [sys.executable, "-P", "-c", _AHEAD], subprocess.DEVNULL
            with suppress(OSError):  # without it, the first run takes longer
                self.ahead = subprocess.Popen(command, stdout=nowhere, stderr=nowhere)
        if self._depth == 1:
            gc.disable()
            self._notify(True)

    def on_end(self, event: object) -> None:
        self._depth -= 1
        if self._depth == 0:
            gc.enable()
            self._notify(False)
