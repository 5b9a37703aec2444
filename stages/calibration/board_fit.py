"""Corners of a chessboard, and the camera matrix and distortion by views of it (Zhang 2000, by OpenCV)."""

from dataclasses import dataclass
from math import degrees, nan, sqrt
from typing import NamedTuple

import cv2
import numpy as np

from wayside.schemas.frame import Camera
from wayside.stages.geometry import rotation_from_vector
from wayside.stages.kernels import Array, Bytes, Floats

WINDOW = 0.33
"""Half side of the window that refines a corner, by the distance to the next: least scatter, 0.04 px (measured)."""
LARGEST_WINDOW_PX = 11
"""That half side at most, as boards are not flat."""
_SMALLEST_PART = (3, 3)
_THOROUGH = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
"""Equalised histograms (CALIB_CB_NORMALIZE_IMAGE) are left out: they cost a third of a pixel on rendered boards."""
_REFINED = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-4)

FEWEST_VIEWS = 4
"""Two determine a camera without distortion (Zhang 2000), two more show a wrong one."""
OUTLIER_RATIO = 3.0
"""A view is left out where its residual exceeds that of the median view by this factor."""
LARGEST_SIGMA = 0.01
"""A larger relative standard error of the focal length is refused: so large is that of positions along the road."""
LENS_MODELS = {"plumb_bob": 4, "plumb_bob_k3": 5, "rational": 8}
"""Number of distortion coefficients that are fitted of each lens model.

k3 is held at 0 in `plumb_bob`, as by the calibrator of ROS: few boards determine it, and then it makes the distortion
near the border worse.
"""

_FLAGS = {"plumb_bob": cv2.CALIB_FIX_K3, "plumb_bob_k3": 0, "rational": cv2.CALIB_RATIONAL_MODEL}
_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)


class Board(NamedTuple):
    """Inner corners along the two sides of a chessboard, and the side of a square in metres (nan: unknown)."""

    columns: int
    rows: int
    square_m: float

    @property
    def points(self) -> Floats:
        """Corners (n, 3) on the board, row by row, in squares."""
        grid = np.mgrid[: self.columns, : self.rows].T.reshape(-1, 2)
        return np.hstack([grid, np.zeros((len(grid), 1))]).astype(np.float32)


class FoundBoard(NamedTuple):
    """Corners (n, 2) in pixels in the order of `Board.points`, or None and the reason in words."""

    corners: Array | None
    why: str


def find_board(grey: Bytes, board: Board) -> FoundBoard:
    """Find all inner corners of a board in a grey image (height, width).

    By localised Radon transform (Duda and Frese 2018), or else by its quadrangles. The corners are then refined to
    where the gradients around a corner are orthogonal to the lines to it (Förstner and Gülch 1987). A board of which
    only a part is found is named as such: its corners cannot be numbered.
    """
    shape = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(grey, shape, flags=_THOROUGH)
    if not found:
        found, corners = cv2.findChessboardCorners(grey, shape)
    if found:
        return FoundBoard(_refined(grey, np.array(corners, np.float32), board), "")
    wanted = f"{board.columns} x {board.rows} inner corners"
    part, _, meta = cv2.findChessboardCornersSBWithMeta(
        grey, _SMALLEST_PART, _THOROUGH | cv2.CALIB_CB_LARGER
    )
    if part and meta is not None and sorted(meta.shape[:2]) != sorted(shape):
        height, width = meta.shape[:2]
        return FoundBoard(
            None,
            f"{width} x {height} inner corners found, not {wanted}: the board is cut off, partly "
            "hidden, or another",
        )
    return FoundBoard(None, f"no board of {wanted} found: too blurred, too small, or another board")


def _refined(grey: Bytes, corners: Floats, board: Board) -> Array:
    """Corners (n, 2) refined in windows that do not reach the next corner."""
    grid = corners.reshape(board.rows, board.columns, 2)
    gaps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    half = int(np.clip(WINDOW * min(gaps), 2, LARGEST_WINDOW_PX))
    refined = cv2.cornerSubPix(grey, corners.reshape(-1, 1, 2), (half, half), (-1, -1), _REFINED)
    return np.asarray(refined, np.float64).reshape(-1, 2)


class CalibrationError(ValueError):
    """Views from which no camera can be calibrated; the words say why."""


class Parameter(NamedTuple):
    """A parameter of the camera.

    `sigma`: standard error for independent errors of the corners. `spread`: standard error by leaving out one view at a
    time (jackknife), which contains errors that the corners of a view share.
    """

    name: str
    value: float
    sigma: float
    spread: float


@dataclass(frozen=True, slots=True)
class FittedView:
    """A view in a calibration.

    `index` counts the views given. `residuals` (n, 2) px. `rms_px` of their lengths. `tilt_deg` of the board against
    the image plane. `distance_squares` of the centre of the board. `used` is False where the view was left out of the
    fit. Its residuals then belong to a pose fitted to it.
    """

    index: int
    residuals: Array
    rms_px: float
    tilt_deg: float
    distance_squares: float
    used: bool


@dataclass(frozen=True, slots=True)
class BoardCalibration:
    """Camera of the used views, rms_px over all their corners, and the `parameters` by their names.

    `by_model`: rms_px of the same views with each of `LENS_MODELS`, nan where it cannot be fitted.
    """

    camera: Camera
    parameters: tuple[Parameter, ...]
    rms_px: float
    by_model: dict[str, float]
    views: tuple[FittedView, ...]


class _Fit(NamedTuple):
    rms_px: float
    matrix: Array
    distortion: Array
    values: Array
    sigma: Array
    view_rms_px: Array


def calibrate_boards(
    views: list[Array], board: Board, size: tuple[int, int], model: str
) -> BoardCalibration:
    """Calibrate a camera by views of a board.

    The worst view is left out, and the rest fitted again, while its residual exceeds that of the median view by
    `OUTLIER_RATIO`.

    `views`: corners (n, 2) of each, pixels, in the order of `board.points`. `size`: width and height of the images.
    `model`: of `LENS_MODELS`.

    Raises CalibrationError for too few views, or views that do not determine the focal length. The message then has the
    residuals of all lens models, because a lens of another kind looks the same.
    """
    kept = list(range(len(views)))
    while True:
        if len(kept) < FEWEST_VIEWS:
            raise CalibrationError(
                f"{FEWEST_VIEWS} views of the board are needed, and there are {len(kept)}. Photograph it 15 to 20 "
                "times, tilted, all over the image."
            )
        fit = _fit([views[i] for i in kept], board, size, model)
        worst = int(np.argmax(fit.view_rms_px))
        if fit.view_rms_px[worst] <= OUTLIER_RATIO * np.median(fit.view_rms_px):
            break
        del kept[worst]
    used = [views[i] for i in kept]
    by_model = {name: _residual_px(used, board, size, name) for name in LENS_MODELS}
    spread = _jackknife(used, board, size, model)
    placed = [_place(i, view, board, fit, used=i in set(kept)) for i, view in enumerate(views)]
    count = 4 + LENS_MODELS[model]
    columns = (_NAMES[:count], fit.values.tolist(), fit.sigma.tolist(), spread.tolist())
    parameters = tuple(map(Parameter, *columns))
    _require_focal_length(parameters, placed, by_model)
    lens = fit.distortion.tolist() + [0.0] * (LENS_MODELS[model] == 4)
    fx, fy, cx, cy = fit.values[:4].tolist()
    camera = Camera(size[0], size[1], fx, fy, cx, cy, tuple(lens))
    return BoardCalibration(camera, parameters, fit.rms_px, by_model, tuple(placed))


def _fit(views: list[Array], board: Board, size: tuple[int, int], model: str) -> _Fit:
    try:
        rms, matrix, distortion, _, _, sigma, _, each = cv2.calibrateCameraExtended(
            [board.points] * len(views),
            [view.astype(np.float32)[:, None] for view in views],
            size,
            np.zeros((3, 3)),
            np.zeros(LENS_MODELS["rational"]),
            flags=_FLAGS[model],
            criteria=_STOP,
        )
    except cv2.error as error:
        raise CalibrationError(
            f"the {len(views)} views do not determine a camera: OpenCV cannot fit them ({error.err}). Photograph the "
            "board tilted and all over the image."
        ) from error
    count, pinhole = LENS_MODELS[model], np.asarray(matrix, np.float64)
    lens = np.ravel(distortion)[:count].astype(np.float64)
    values = np.concatenate([pinhole[[0, 1, 0, 1], [0, 1, 2, 2]], lens])
    sigmas, by_view = (np.ravel(one).astype(np.float64) for one in (sigma, each))
    return _Fit(float(rms), pinhole, lens, values, sigmas[: 4 + count], by_view)


def _residual_px(views: list[Array], board: Board, size: tuple[int, int], model: str) -> float:
    try:
        return _fit(views, board, size, model).rms_px
    except CalibrationError:
        return nan


def format_residuals(by_model: dict[str, float]) -> str:
    """Residual of each lens model in words."""
    return ", ".join(f"{name} {rms_px:.3f}" for name, rms_px in by_model.items()) + " px RMS"


def _jackknife(views: list[Array], board: Board, size: tuple[int, int], model: str) -> Array:
    """Standard errors (4 + coefficients,) by leaving out one view at a time; nan where a fit fails."""
    parts = [views[:i] + views[i + 1 :] for i in range(len(views))]
    try:
        found = np.array([_fit(part, board, size, model).values for part in parts])
    except CalibrationError:
        return np.full(4 + LENS_MODELS[model], np.nan)
    squares: Array = ((found - found.mean(axis=0)) ** 2).sum(axis=0)
    return np.sqrt(squares * (len(views) - 1) / len(views))


def _place(index: int, view: Array, board: Board, fit: _Fit, *, used: bool) -> FittedView:
    points = board.points.astype(np.float64)
    _, turn, shift = cv2.solvePnP(points, view, fit.matrix, fit.distortion)
    projected, _ = cv2.projectPoints(points, turn, shift, fit.matrix, fit.distortion)
    residuals = view - projected.reshape(-1, 2)
    rotation = rotation_from_vector(np.asarray(turn, np.float64).ravel())
    centre = rotation @ points.mean(axis=0) + shift.ravel()
    tilt = degrees(np.arccos(min(1.0, abs(float(rotation[2, 2])))))
    rms = sqrt(float((residuals**2).sum(axis=1).mean()))
    return FittedView(index, residuals, rms, tilt, float(np.linalg.norm(centre)), used)


def _require_focal_length(
    parameters: tuple[Parameter, ...], views: list[FittedView], by_model: dict[str, float]
) -> None:
    for one in parameters[:2]:
        error = max(one.sigma, one.spread) / abs(one.value)
        if not error <= LARGEST_SIGMA:
            tilt = max(view.tilt_deg for view in views if view.used)
            raise CalibrationError(
                f"the views do not determine the focal length: {one.name} = {one.value:.0f} px has a standard error "
                f"of {100 * error:.1f} % from {sum(v.used for v in views)} boards tilted by {tilt:.0f} degrees at "
                "most. Photograph the board tilted by 30 to 45 degrees to both sides, upwards and downwards, near "
                f"and large. Residuals by lens model: {format_residuals(by_model)}. Where another model leaves far "
                "less (a wide lens), give it by --model."
            )
