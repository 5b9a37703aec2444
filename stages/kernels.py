"""Compiled kernels: machine code without the interpreter lock, kept on disk; and checks of the arrays they get."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from llvmlite.binding import parse_bitcode
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Numbers = NDArray[np.int64]
Flags = NDArray[np.bool_]
"""Arrays of doubles, the usual argument of a geometric kernel, and of the other usual types."""

# Division by zero gives inf or nan as in NumPy, so that no division carries a branch that raises; the wrapper for
# callers in C is left out. Both only lengthen compilation.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(function: Kernel) -> Kernel:
    """The function as machine code that runs without the interpreter lock and is cached between processes.

    Compiled code checks no bounds: a wrong shape, type or layout crashes the process. Call a kernel only through a
    plain function that checks its arrays first (`require_array`, `shaped`).
    """
    try:
        kernel: Any = numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:
        # The cache has no folder: a read-only installation compiles in every process.
        return cast(Kernel, numba.njit(**_OPTIONS)(function))
    index, codes = kernel._cache._cache_file, kernel._cache._impl
    load, rebuild = index._load_index, codes.rebuild

    def current() -> dict[Any, Any]:
        """The index, empty where it names types of an earlier version of the code, which numba fails to read."""
        try:
            return cast(dict[Any, Any], load())
        except (AttributeError, ImportError):
            return {}

    def packed(context: Any, stored: Any) -> Any:
        """The code; its module, which only kernels that link it read, stays packed: a run takes 15 MB less."""
        found, (_, _, (_, bitcode)) = rebuild(context, stored), stored[0]
        found.library._shared_module = None
        found.library._get_module_for_linking = lambda: parse_bitcode(bitcode)
        return found

    index._load_index, codes.rebuild = current, packed
    return cast(Kernel, kernel)


def compiled_within(function: Kernel, reorder: bool = False) -> Kernel:
    """Like `compiled`, for kernels that only other kernels call.

    Their machine code is part of each kernel that calls them and is cached there. They have no cache of their own, and
    no wrapper for callers in Python, which takes long to be compiled where the arguments are many arrays.
    `reorder`: terms of sums are added in any order, several at a time; the last digits then depend on the processor.
    It is inlined: else the process that compiles it may run another copy, of another order, than those that load it.
    """
    math = {"reassoc", "nsz"} if reorder else False
    options = _OPTIONS | {"no_cpython_wrapper": True, "fastmath": math, "forceinline": reorder}
    return cast(Kernel, numba.njit(**options)(function))


def require_array(
    array: NDArray[Any], name: str, dtype: type[np.generic], shape: tuple[int | None, ...]
) -> None:
    """Refuse an array whose type, shape (None: any length) or layout a kernel does not take.

    Raises ValueError, which names the array and both shapes or layouts.
    """
    fits = len(array.shape) == len(shape) and all(
        n is None or n == found for n, found in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype != dtype:
        wanted = " x ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(
            f"{name}: {' x '.join(map(str, array.shape))} {array.dtype.name} instead of {wanted} "
            f"{np.dtype(dtype).name}. Convert it first."
        )
    if not array.flags.c_contiguous:
        raise ValueError(
            f"{name}: the array is not C-contiguous (strides {array.strides}). Pass np.ascontiguousarray(...)."
        )


def require_image(rgb: NDArray[np.uint8], name: str = "rgb") -> None:
    """Refuse anything but a C-contiguous (height, width, 3) uint8 image."""
    require_array(rgb, name, np.uint8, (None, None, 3))


def shaped(array: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """The array as C-contiguous float64; ValueError, with both shapes, unless it has the shape (-1: any length)."""
    result = np.ascontiguousarray(array, np.float64)
    fits = result.ndim == len(shape) and all(
        want in (-1, have) for want, have in zip(shape, result.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"an array of shape {result.shape} instead of {shape} (-1: any)")
    return result
