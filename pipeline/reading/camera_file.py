"""Camera calibrations as files of the form ROS tools write (camera_info YAML)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import yaml

from wayside.pipeline.reading.contents import ContentError, make_camera
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera

LARGEST_FILE = 1 << 16
"""Characters that are read: a calibration has about a thousand."""
_MOST_NUMBERS = 64
_EXAMPLE = "image_width, image_height, camera_matrix, distortion_model and distortion_coefficients"


def read_camera_file(path: Path) -> Camera:
    """Camera of a ROS camera_info YAML file.

    Raises
    ------
    InputError
        The file cannot be read or is no calibration of that form.
    """
    try:
        with path.open(encoding="utf-8") as stream:
            text = stream.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text"
        raise InputError(
            f"{path}: wanted a camera calibration to read, found: {reason}; check the name"
        ) from error
    return parse_camera(text, str(path))


def parse_camera(text: str, name: str) -> Camera:
    """Camera of the text of a ROS camera_info YAML file; `name` is for errors.

    Raises
    ------
    InputError
        The text is no calibration of that form.
    """
    try:
        if len(text) > LARGEST_FILE:
            raise ContentError(f"over {LARGEST_FILE} characters")
        content = yaml.safe_load(text)
        if not isinstance(content, dict):
            raise ContentError("it has no named entries")
        missing = [k for k in ("image_width", "image_height", "camera_matrix") if k not in content]
        if missing:
            raise ContentError(f"it has no {missing[0]}")
        return make_camera(
            (int(content["image_width"]), int(content["image_height"])),
            _numbers(content["camera_matrix"]),
            str(content.get("distortion_model") or ""),
            _numbers(content.get("distortion_coefficients", ())),
        )
    except (yaml.YAMLError, TypeError, ValueError, OverflowError, RecursionError) as error:
        broken = isinstance(error, (yaml.YAMLError, RecursionError))
        what = "no YAML" if broken else f"a fault: {error}"
        raise InputError(
            f"{name}: wanted a camera calibration (ROS camera_info YAML), found {what}; "
            f"such a file has {_EXAMPLE}"
        ) from error


def format_camera(camera: Camera, name: str, comments: Sequence[str] = ()) -> str:
    """Text of a ROS camera_info YAML file of a camera, which `parse_camera` reads back to the same camera.

    `comments` are lines at its head. The images are not rectified: the rectification is the identity, and the
    projection that of the camera matrix.
    """
    c = camera
    matrix = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]
    projection = [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    distortion = list(c.distortion or (0.0,) * 5)
    content = {
        "image_width": c.width,
        "image_height": c.height,
        "camera_name": name,
        "camera_matrix": _matrix(3, 3, matrix),
        "distortion_model": "plumb_bob" if len(distortion) <= 5 else "rational_polynomial",
        "distortion_coefficients": _matrix(1, len(distortion), distortion),
        "rectification_matrix": _matrix(3, 3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        "projection_matrix": _matrix(3, 4, projection),
    }
    head = "".join(f"# {line}\n" for line in comments)
    return head + yaml.safe_dump(content, sort_keys=False, width=1000, default_flow_style=None)


def _matrix(rows: int, columns: int, data: list[float]) -> dict[str, int | list[float]]:
    return {"rows": rows, "cols": columns, "data": [float(value) for value in data]}


def _numbers(entry: Any) -> tuple[float, ...]:
    """Numbers of a matrix entry: `{rows, cols, data: [...]}`, a list, or a list of rows."""
    values = entry.get("data", ()) if isinstance(entry, dict) else entry
    rows = values if isinstance(values, (list, tuple)) else [values]
    flat = (v for row in rows for v in (row if isinstance(row, list) else [row]))
    numbers = tuple(float(v) for v in islice(flat, _MOST_NUMBERS + 1))
    if len(numbers) > _MOST_NUMBERS:
        raise ContentError(f"a matrix of over {_MOST_NUMBERS} numbers")
    return numbers
