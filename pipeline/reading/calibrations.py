"""Cameras from calibrations: which lens and matrix are possible, which matrix fits which images, and as files.

The files are YAML: camera_info of ROS, FileStorage of OpenCV, camchain of Kalibr.
"""

import math
import re
from collections.abc import Hashable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from wayside.pipeline.files.input_files import decoded, open_input
from wayside.pipeline.files.parsing import CONTENT_FAULTS, YamlLoader, parse_yaml
from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.reading.contents import CalibrationContent, ContentError
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera

_BROWN_LENSES = frozenset(
    ("", "plumb_bob", "rational_polynomial", "radtan", "radial_tangential", "brown_conrady")
)
_PINHOLES = frozenset(
    "none pinhole perspective undistorted rectified inverse_brown_conrady modified_brown_conrady".split()
)
"""Models without distortion, and two of RealSense that have none if all coefficients are zero."""
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
_ROUNDING = 1e-9
"""Entries of a camera matrix smaller than this, relative to its focal length, are errors of rounding."""
_LARGEST_IMAGE_PX = 200_000_000
"""The largest survey cameras have 150 million; each pixel takes some dozen bytes while its image is processed."""
_NARROWEST_DEG, _WIDEST_DEG = 0.1, 170.0
"""Of a telescope, and of a lens whose image a plane can hold; other angles are a slip in the focal length."""
_MOST_OBLONG = 2.1
"""Ratio of the focal lengths: pixels are square, and binning of one axis, fields and squeezing lenses make it 2."""
_SURE_SHARE = 0.9
"""Of the way from the centre to the border: beyond it no board was seen, and fits of real lenses go astray there."""
_MOST_STRETCH = 1.5
"""Distance from the centre over that of a pinhole; strong pincushion distortion has 1.2."""
_DIRECTIONS, _RADII = 48, 160
_FURTHEST_CENTRE = 0.05
"""Of centres from the middle of the sensor, in its longer side: some drivers bin or cut the matrix themselves."""
_RECTIFIED = re.compile(r"(?:^|[/_])(?:rect|rectified|undistorted)(?:[/_]|$)", re.IGNORECASE)
OTHER_LENSES = (
    "Positions follow from pinhole rays. For a fisheye, fit --model rational to images of a board, or remap the images "
    "to a pinhole first (cv2.fisheye.undistortImage)"
)
"""What to do where a lens has another model."""
LARGEST_FILE = 1 << 16
"""Characters that are read: a calibration has about a thousand."""
_EXAMPLE = "image_width, image_height, camera_matrix, distortion_model and distortion_coefficients"
_OPENCV_HEAD = re.compile(r"\A\ufeff?%YAML[^\n]*\n")
"""First line of OpenCV: `%YAML:1.0` up to its version 4 is no YAML directive, and 1.2 one that PyYAML warns of."""
_SIZE_KEYS = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_MATRIX_KEYS = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K")
_LENS_KEYS = "distortion_coefficients Distortion_Coefficients distCoeffs dist_coeffs D".split()

Size = tuple[int, int]
Matrix = tuple[float, ...]


class Region(NamedTuple):
    """Part of the sensor that is read out, in its pixels (no width: all of it), and how many become one."""

    left: int = 0
    top: int = 0
    width: int = 0
    height: int = 0
    bin_x: int = 1
    bin_y: int = 1


def is_rectified(topic: str) -> bool:
    """Whether a topic says by its name that its images are rectified, as `image_rect_color` does."""
    return _RECTIFIED.search(topic) is not None


def make_calibration(
    time_ns: int | None,
    frame_id: str,
    size: Size,
    k: Matrix,
    p: Matrix,
    lens: tuple[str, Matrix],
    region: Region,
) -> CalibrationContent:
    """The cameras of a CameraInfo: of raw images by `k` (3x3) and the lens, of rectified ones by `p` (3x4) alone.

    `size`: of the sensor. `lens`: ROS name of the model, coefficients. If `p` is zero, a `k` without distortion serves.
    """
    raw, why = _cameras(size, k, lens, region)
    if any(p):
        square = (*p[0:3], *p[4:7], *p[8:11]) if len(p) == 12 else ()
        rectified, why_rectified = _cameras(size, square, ("", ()), region)
    elif any(camera.distortion for camera in raw):
        rectified, why_rectified = (), "the images are rectified, but it has no P, their matrix"
    else:
        rectified, why_rectified = raw, why
    return CalibrationContent(time_ns, frame_id, raw, rectified, why, why_rectified)


def _cameras(
    size: Size, matrix: Matrix, lens: tuple[str, Matrix], region: Region
) -> tuple[tuple[Camera, ...], str]:
    """One camera for each size that images may have, and why the first size has no camera.

    That is the size of the region, binned; then the size stated, which `matrix` is of.
    """
    r = region
    width, height = r.width or size[0], r.height or size[1]
    if len(matrix) != 9:
        return (), "its camera matrix is not 3 x 3"
    if r.left + width > size[0] or r.top + height > size[1]:
        return (), f"its region of interest reaches beyond its {size[0]} x {size[1]} pixels"
    k = matrix
    off = max(abs(k[2] - size[0] / 2), abs(k[5] - size[1] / 2)) / max(*size, 1)
    if k[0] > 0 and r != Region() and off > _FURTHEST_CENTRE:
        return (), (
            f"its centre {k[2]:g}, {k[5]:g} is not that of the full sensor, which binning and region of interest are "
            "applied to"
        )
    row_x = (k[0] / r.bin_x, k[1], (k[2] - r.left) / r.bin_x)
    row_y = (k[3], k[4] / r.bin_y, (k[5] - r.top) / r.bin_y)
    shown = (width // r.bin_x, height // r.bin_y)
    cameras: dict[Size, Camera] = {}
    faults: dict[Size, str] = {}
    for images, own in ((shown, (*row_x, *row_y, *k[6:])), (size, matrix)):
        try:
            cameras[images] = make_camera(images, own, *lens)
        except ContentError as error:
            faults[images] = str(error)
    return tuple(cameras.values()), faults.get(shown, "")


def make_camera(size: Size, k: Matrix, model: str, d: Matrix) -> Camera:
    """A camera of the 3x3 matrix `k` (row by row) and the distortion `d` of a lens model by its ROS name.

    Raises ContentError where it is not calibrated, its pixels are skewed, or its lens cannot be used.
    """
    if len(k) != 9 or not all(map(math.isfinite, (*k, *d))) or k[0] <= 0 or k[4] <= 0:
        raise ContentError("it has no focal length (not calibrated)")
    width, height = size
    if min(size) <= 0 or width * height > _LARGEST_IMAGE_PX:
        raise ContentError(f"its image size {width} x {height} is not plausible")
    fault = next(_matrix_faults(size, k), "")
    name = re.sub(r"[\s-]+", "_", model.strip().lower())
    if fault:
        raise ContentError(fault)
    if name not in _BROWN_LENSES and not (name in _PINHOLES and not any(d)):
        raise ContentError(
            f"its lens model {model} is not supported; plumb_bob and rational_polynomial are. {OTHER_LENSES}"
        )
    if not any(d):
        d = ()
    if len(d) not in _COEFFICIENTS:
        raise ContentError(
            f"its lens has {len(d)} coefficients; 0, 4, 5, 8, 12 or 14 are supported"
        )
    camera = Camera(width, height, k[0], k[4], k[2], k[5], d)
    if d and not _is_lens(camera):
        raise ContentError(
            f"its distortion {', '.join(f'{one:g}' for one in d)} fits no lens: points of the image have "
            "no direction, or several"
        )
    return camera


def _matrix_faults(size: Size, k: Matrix) -> Iterator[str]:
    for focal, centre, length in ((k[0], k[2], size[0]), (k[4], k[5], size[1])):
        angle = math.degrees(2 * math.atan2(length / 2, focal))
        if not _NARROWEST_DEG < angle < _WIDEST_DEG:
            yield f"its focal length {focal:g} px makes an angle of view of {angle:.3g} degrees over {length} px"
        if not -length <= centre <= 2 * length:
            yield f"its centre {centre:g} px lies far outside of the image of {length} px"
    if max(k[0] / k[4], k[4] / k[0]) > _MOST_OBLONG:
        yield f"its focal lengths {k[0]:g} and {k[4]:g} px differ more than those of any camera"
    if abs(k[1]) > _ROUNDING * k[0]:
        yield (
            f"its camera matrix has skew ({k[1]:g} px), which is not corrected here; "
            "calibrate with skew fixed at 0"
        )
    if max(abs(k[3]), abs(k[6]), abs(k[7])) > _ROUNDING * k[0] or abs(k[8] - 1) > _ROUNDING:
        yield "its camera matrix is not of the form fx 0 cx, 0 fy cy, 0 0 1"


@lru_cache(maxsize=16)
def _is_lens(camera: Camera) -> bool:
    """Whether the distortion maps directions to the image one to one, and stretches it no more than lenses do.

    Followed are rays that go outward from the axis, until each has left `_SURE_SHARE` of the image.
    """
    c = camera
    corner = math.hypot(max(c.cx, c.width - c.cx) / c.fx, max(c.cy, c.height - c.cy) / c.fy)
    within = np.linspace(0, corner, _RADII // 2 + 1)[1:]
    radius = np.concatenate((within, np.geomspace(corner, 100 * corner, _RADII // 2 + 1)[1:]))
    angle = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
    ray = np.stack((np.cos(angle), np.sin(angle)), -1)
    points = np.ones((_RADII, _DIRECTIONS, 3))
    points[..., :2] = radius[:, None, None] * ray
    zero = np.zeros(3)
    flat = points.reshape(-1, 1, 3)
    with np.errstate(all="ignore"):
        seen = cv2.projectPoints(flat, zero, zero, np.eye(3), np.array(c.distortion))[0]
        seen = seen.reshape(_RADII, _DIRECTIONS, 2)
        outward = np.diff(seen, axis=0, prepend=0.0)
        around = np.roll(seen, -1, 1) - np.roll(seen, 1, 1)
        turn = outward[..., 0] * around[..., 1] - outward[..., 1] * around[..., 0]
        sound = np.logical_and.accumulate(turn > 0, axis=0)
        x, y = seen[..., 0] * c.fx, seen[..., 1] * c.fy
        inside = (x > _SURE_SHARE * min(-c.cx, 0)) & (x < _SURE_SHARE * max(c.width - c.cx, 0))
        inside &= (y > _SURE_SHARE * min(-c.cy, 0)) & (y < _SURE_SHARE * max(c.height - c.cy, 0))
        stretch = np.linalg.norm(seen, axis=-1) / radius[:, None]
    left = sound & ~inside & (stretch < _MOST_STRETCH)
    return bool((left.any(0)).all())


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
            f"its camera model {model} with {len(numbers)} numbers is not supported; pinhole with 4 is"
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
    distortion = np.array([c.distortion or (0.0,) * 5], np.float64)
    content = {
        "image_width": c.width,
        "image_height": c.height,
        "camera_name": name,
        "camera_matrix": _matrix(c.matrix),
        "distortion_model": "plumb_bob" if distortion.size <= 5 else "rational_polynomial",
        "distortion_coefficients": _matrix(distortion),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.pad(c.matrix, ((0, 0), (0, 1)))),
    }
    head = "".join(f"# {visible(line)}\n" for line in comments)
    return head + yaml.safe_dump(content, sort_keys=False, width=1000, default_flow_style=None)


def _matrix(values: NDArray[np.float64]) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": values.ravel().tolist()}


def _numbers(entry: Any) -> tuple[float, ...]:
    """Numbers of a matrix entry: `{rows, cols, data: [...]}`, a list, or a list of rows."""
    values = entry.get("data", ()) if isinstance(entry, dict) else entry
    rows = values if isinstance(values, (list, tuple)) else [values]
    flat = (v for row in rows for v in (row if isinstance(row, list) else [row]))
    return tuple(float(v) for v in flat)
