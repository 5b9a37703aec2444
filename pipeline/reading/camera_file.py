"""Camera calibrations as files: camera_info of ROS, FileStorage of OpenCV, camchain of Kalibr; all of them YAML."""

from __future__ import annotations

import re
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import yaml

from wayside.pipeline.files.input_files import decoded, open_input
from wayside.pipeline.files.parsing import CONTENT_FAULTS, YamlLoader, parse_yaml
from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.reading.calibrations import make_camera
from wayside.pipeline.reading.contents import ContentError
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera

LARGEST_FILE = 1 << 16
"""Characters that are read: a calibration has about a thousand."""
_EXAMPLE = "image_width, image_height, camera_matrix, distortion_model and distortion_coefficients"
_OPENCV_HEAD = re.compile(r"\A\ufeff?%YAML[^\n]*\n")
"""First line of OpenCV: `%YAML:1.0` up to its version 4 is no YAML directive, and 1.2 one that PyYAML warns of."""
_SIZE_KEYS = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_MATRIX_KEYS = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K")
_LENS_KEYS = (
    *("distortion_coefficients", "Distortion_Coefficients"),
    *("distCoeffs", "dist_coeffs", "D"),
)


class _Loader(YamlLoader):
    """The safe loader, which also takes the matrices of OpenCV for the mappings they are."""


def _opencv_matrix(loader: _Loader, node: yaml.Node) -> dict[Hashable, Any]:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.YAMLError("a matrix of OpenCV that has no named entries")
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def read_camera_file(path: Path) -> Camera:
    """Camera of a calibration file; raises InputError where it cannot be read, or as `parse_camera`."""
    try:
        with open_input(path) as stream:
            text = decoded(stream.read(LARGEST_FILE + 1))
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text"
        raise InputError(
            f"{path}: the camera calibration cannot be read: {reason}. Check the name."
        ) from error
    return parse_camera(text, str(path))


def parse_camera(text: str, name: str) -> Camera:
    """Camera of the text of a calibration file of ROS, OpenCV or Kalibr; `name` is for errors.

    Of OpenCV: image size, matrix and distortion under the names its samples and tools give them, 4, 5, 8, 12 or 14
    coefficients. Of Kalibr: `cam0`, model `pinhole`, distortion `radtan` or `none`.

    Raises InputError where the text is no calibration of that form.
    """
    try:
        if len(text) > LARGEST_FILE:
            raise ContentError(f"over {LARGEST_FILE} characters")
        content = parse_yaml(_OPENCV_HEAD.sub("", text), _Loader)
        if not isinstance(content, dict):
            raise ContentError("it has no named entries")
        return _kalibr(content["cam0"]) if "cam0" in content else _matrices(content)
    except CONTENT_FAULTS as error:
        raise InputError(
            f"{name}: this is not a camera calibration (YAML of ROS camera_info, OpenCV or Kalibr): {error}. A file "
            f"of ROS has {_EXAMPLE}."
        ) from error


def _matrices(content: dict[str, Any]) -> Camera:
    """Camera of ROS or OpenCV."""
    sizes = [pair for pair in _SIZE_KEYS if pair[0] in content or pair[1] in content]
    width, height = sizes[0] if sizes else _SIZE_KEYS[0]
    matrix = next((k for k in _MATRIX_KEYS if k in content), _MATRIX_KEYS[0])
    missing = [k for k in (width, height, matrix) if k not in content]
    if missing:
        raise ContentError(f"it has no {missing[0]}")
    lens = next((k for k in _LENS_KEYS if k in content), "")
    fisheye = content.get("fisheye_model") not in (None, 0, False)
    return make_camera(
        (int(content[width]), int(content[height])),
        _numbers(content[matrix]),
        "fisheye" if fisheye else str(content.get("distortion_model") or ""),
        _numbers(content.get(lens, ())),
    )


def _kalibr(content: Any) -> Camera:
    """Camera of an entry of a camchain: intrinsics fu, fv, pu, pv, resolution, and distortion k1, k2, p1, p2."""
    if not isinstance(content, dict):
        raise ContentError("its cam0 has no named entries")
    missing = [k for k in ("camera_model", "intrinsics", "resolution") if k not in content]
    if missing:
        raise ContentError(f"its cam0 has no {missing[0]}")
    model, numbers = str(content["camera_model"]), _numbers(content["intrinsics"])
    if model != "pinhole" or len(numbers) != 4:
        raise ContentError(
            f"its camera model {model} with {len(numbers)} numbers is not understood; pinhole with 4 is"
        )
    fu, fv, pu, pv = numbers
    width, height = _numbers(content["resolution"])
    lens = str(content.get("distortion_model") or "none")
    return make_camera(
        (int(width), int(height)),
        (fu, 0.0, pu, 0.0, fv, pv, 0.0, 0.0, 1.0),
        "" if lens == "none" else lens,
        _numbers(content.get("distortion_coeffs", ())),
    )


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
    head = "".join(f"# {visible(line)}\n" for line in comments)
    return head + yaml.safe_dump(content, sort_keys=False, width=1000, default_flow_style=None)


def _matrix(rows: int, columns: int, data: list[float]) -> dict[str, int | list[float]]:
    return {"rows": rows, "cols": columns, "data": [float(value) for value in data]}


def _numbers(entry: Any) -> tuple[float, ...]:
    """Numbers of a matrix entry: `{rows, cols, data: [...]}`, a list, or a list of rows."""
    values = entry.get("data", ()) if isinstance(entry, dict) else entry
    rows = values if isinstance(values, (list, tuple)) else [values]
    flat = (v for row in rows for v in (row if isinstance(row, list) else [row]))
    return tuple(float(v) for v in flat)
