"""Compile a numerical kernel once, without the interpreter lock, and keep it on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of doubles, the usual argument of a geometric kernel."""

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(function: Kernel) -> Kernel:
    """The function as machine code that runs without the interpreter lock and is cached between processes.

    Compiled code checks no bounds: a wrong shape, type or layout crashes the process. Call a kernel only through a
    plain function that checks its arrays first (see `wayside.stages.numerics.guards`).
    """
    return _compile(function)


def compiled_exact(function: Kernel) -> Kernel:
    """Like `compiled`, and multiply-adds may be fused: for kernels whose results are exact either way."""
    return _compile(function, {"contract"})


def _compile(function: Kernel, fastmath: bool | set[str] = False) -> Kernel:
    try:
        return cast(Kernel, numba.njit(nogil=True, cache=True, fastmath=fastmath)(function))
    except RuntimeError:
        # No folder to keep it in: a read-only installation compiles anew in every process.
        return cast(Kernel, numba.njit(nogil=True, fastmath=fastmath)(function))
