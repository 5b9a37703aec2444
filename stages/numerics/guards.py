"""Checks at the door of compiled kernels, which themselves check no bounds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def require_array(
    array: NDArray[Any], name: str, dtype: type[np.generic], shape: tuple[int | None, ...]
) -> None:
    """Refuse an array of another type, shape (None: any length) or layout than a kernel was made for.

    Raises
    ------
    ValueError
        Naming the array, what was wanted, what was found and what to do.
    """
    wanted = " x ".join("any" if n is None else str(n) for n in shape)
    fits = len(array.shape) == len(shape) and all(
        n is None or n == found for n, found in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype != dtype:
        raise ValueError(
            f"{name}: wanted {wanted} {np.dtype(dtype).name}, found "
            f"{' x '.join(map(str, array.shape))} {array.dtype.name}; convert it first"
        )
    if not array.flags.c_contiguous:
        raise ValueError(
            f"{name}: wanted a C-contiguous array, found strides {array.strides}; "
            "pass np.ascontiguousarray(...)"
        )


def require_picture(rgb: NDArray[np.uint8], name: str = "rgb") -> None:
    """Refuse anything but a C-contiguous (height, width, 3) uint8 picture."""
    require_array(rgb, name, np.uint8, (None, None, 3))


def shaped(array: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """The array as C-contiguous float64, refused unless it has the shape (-1: any length).

    Raises
    ------
    ValueError
        Naming the shape that was wanted and the one found.
    """
    result = np.ascontiguousarray(array, np.float64)
    fits = result.ndim == len(shape) and all(
        want in (-1, have) for want, have in zip(shape, result.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"wanted an array of shape {shape} (-1: any), found {result.shape}")
    return result
