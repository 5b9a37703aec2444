"""Plan a survey: simulate it, locate its signs by the stages of `wayside run`, compare with truth and bound."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from math import atan, degrees, inf, radians, tan
from pathlib import Path
from typing import Any

import numpy as np

from wayside.pipeline.files.writing import write_json
from wayside.pipeline.simulation.bound import motion_jacobian, point_bound, step_bound
from wayside.pipeline.simulation.drive import SimulatedDrive, Survey
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.landmarks import Landmark
from wayside.schemas.settings import MotionSettings, TrackSettings
from wayside.stages.geometry import rays_of_ideal
from wayside.stages.kernels import Array
from wayside.stages.mapping import track

AXES = ("along", "lateral", "up")
_ORDER = [2, 0, 1]
"""Right, down, ahead of the camera as along, lateral, up."""
SWEEP_SPACING, SWEEP_FOCAL = (0.25, 0.5, 1.0, 1.5, 2.0), (0.5, 0.7, 1.0, 1.4, 2.0)
"""Spacings and focal lengths of a sweep, as multiples of those given."""
UNKNOWN_LENGTH_M = 100.0
FEWEST_VIEWS = 3
"""Views that locate a sign here: pixels decide whether two boxes show one panel, and there are no pixels."""
LEAST_SIGMA_PX = 0.01
"""Scatter assumed of boxes that a survey places exactly."""
BOUNDED = 16
"""Signs whose bound is computed, at most, evenly spaced along the drive."""


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """Errors of the n signs that were found, in the camera of the closest whole view: along, lateral, up, metres."""

    survey: Survey
    wanted: int
    """Signs that three or more images show."""
    error: Array
    """Reported minus true, (n, 3)."""
    sigma: Array
    """As stated, (n, 3)."""
    bound: Array
    """Cramér-Rao, of m of them, (m, 3)."""
    nearest: Array
    """Distance of the closest view, (n,)."""

    @property
    def total(self) -> Array:
        """Distance between reported and true position (n,)."""
        return np.asarray(np.linalg.norm(self.error, axis=1))

    def figures(self, axis: int) -> dict[str, float]:
        """Figures of the errors along an axis."""
        error, sigma = self.error[:, axis], self.sigma[:, axis]
        return _quantiles(error) | {
            "sigma_m": float(np.median(sigma)),
            "bound_m": float(np.median(self.bound[:, axis])),
            "within_1_sigma": float((np.abs(error) < sigma).mean()),
            "within_2_sigma": float((np.abs(error) < 2 * sigma).mean()),
        }

    def to_json(self) -> dict[str, Any]:
        """All figures, rounded to a tenth of a millimetre."""
        given = asdict(self.survey).items()
        error = {axis: self.figures(k) for k, axis in enumerate(AXES)}
        error["total"] = _quantiles(self.total)
        return {
            "survey": {name: None if value == inf else value for name, value in given},
            "signs": self.wanted,
            "found": len(self.error),
            "nearest_m": round(float(np.median(self.nearest)), 4),
            "error": {
                axis: {k: round(v, 3 if "within" in k else 4) for k, v in told.items()}
                for axis, told in error.items()
            },
        }


def simulate(
    survey: Survey, watch: Callable[[int, int], None] = lambda done, total: None
) -> SimulationResult:
    """Simulate a survey and compare the located signs with the truth; watch: how many of all images are done.

    Raises UsageError where an option is out of range, or no sign is seen often enough.
    """
    check(survey)
    drive = SimulatedDrive(survey)
    settings = TrackSettings(fewest_views=FEWEST_VIEWS)
    # the stated sigmas include the errors that the survey has
    noise = (max(survey.noise_px, LEAST_SIGMA_PX), survey.noise_share)
    found: dict[int, Landmark] = {}
    settled_frames = track(drive.posed(MotionSettings()), settings, jointly=True, box_sigma=noise)
    for done, settled in enumerate(settled_frames, 1):
        watch(done, len(drive.poses))
        for place in settled.landmarks:
            if place.verdict != "sign":
                continue
            seen = [drive.seen[view.frame].sign[view.row] for view in place.views]
            sign = int(np.bincount(seen).argmax())
            if sign not in found or len(place.views) > len(found[sign].views):
                found[sign] = place
    shown = np.bincount(np.concatenate([s.sign for s in drive.seen]), minlength=survey.signs)
    wanted = int((shown >= settings.fewest_views).sum())
    if not found:
        raise UsageError(
            f"no sign was seen in {settings.fewest_views} images and located: shorten --spacing, or widen the view "
            "by a shorter focal length"
        )
    places = [found[sign] for sign in sorted(found)]
    true = np.array(
        [drive.poses[found[k].best_frame].to_camera(drive.signs[k]) for k in sorted(found)]
    )
    error = (np.array([place.position for place in places]) - true)[:, _ORDER] * [1, 1, -1]
    sigma = np.sqrt([np.diag(place.covariance)[_ORDER] for place in places])
    bounds = _bounds(drive, sorted(found)[:: -(-len(found) // BOUNDED)])
    return SimulationResult(survey, wanted, error, sigma, bounds, np.linalg.norm(true, axis=1))


def check(survey: Survey) -> None:
    """Refuse a survey whose options are out of range: UsageError with the option and what it may be."""
    s = survey
    turned = max(abs(s.mount_yaw_deg), abs(s.mount_pitch_deg), key=lambda one: (one != one, one))
    limits: list[tuple[str, float, float, float, str]] = [
        ("--spacing", s.spacing_m, 0.2, 100, "0.2 m to 100 m"),
        ("--focal-px", s.focal_px, 100, 20_000, "100 to 20000"),
        ("--noise-px", s.noise_px, 0, 20, "0 to 20"),
        ("--lateral", abs(s.lateral_m), 0.1, 50, "0.1 m to 50 m"),
        ("--curve-radius", s.curve_radius_m, 30, inf, "30 m or more"),
        ("--hill", s.hill_m, 0, 40, "0 m to 40 m"),
        ("--drop-rate", s.drop_rate, 0, 0.5, "0 to 0.5"),
        ("--outliers", s.outliers, 0, 0.5, "0 to 0.5"),
        ("--mount-yaw, --mount-pitch", turned, 0, 10, "-10 to 10 degrees"),
        ("--signs", s.signs, 1, 20_000, "1 to 20000"),
        ("--seed", s.seed, 0, inf, "0 or more"),
        ("--jitter", s.jitter_deg, 0, 10, "0 to 10 degrees"),
        ("--trigger-sigma", s.trigger_m, 0, s.spacing_m / 4, "a quarter of --spacing at most"),
        ("--pose-sigma", inf if s.pose_m is None else s.pose_m, 0.001, inf, "1 mm or more"),
    ]
    for option, value, low, high, words in limits:
        if not low <= value <= high:
            raise UsageError(
                f"{option} must be {words}, not {value:g}. See `wayside simulate --help`."
            )


def focal_of_view(hfov_deg: float, width: int) -> float:
    """Focal length in pixels of an image of this width and horizontal angle of view; raises UsageError."""
    if not 1 < hfov_deg < 170:
        raise UsageError(f"--hfov: {hfov_deg:g} is outside 1 to 170 degrees")
    return width / 2 / tan(radians(hfov_deg) / 2)


def view_of_focal(survey: Survey) -> float:
    """Horizontal angle of view, degrees."""
    return 2 * degrees(atan(survey.width / 2 / survey.focal_px))


def sweep(survey: Survey) -> list[Survey]:
    """The survey with spacings and focal lengths around those given."""
    return [
        replace(survey, spacing_m=spacing * survey.spacing_m, focal_px=focal * survey.focal_px)
        for spacing in SWEEP_SPACING
        for focal in SWEEP_FOCAL
    ]


def reaches(one: SimulationResult, target_m: float) -> bool:
    """Whether 95 % of all signs were located within the target; a sign that was not found counts as outside."""
    return bool((one.total < target_m).sum() >= 0.95 * one.wanted)


OWN_KEYS = ("schema_version", "surveys")
"""Of a file of figures."""


def write_simulation(
    tried: Sequence[SimulationResult], file: Path, *, overwrite: bool = False
) -> None:
    """Write the figures of one survey, or of all that a sweep tried, as JSON; raises OutputError.

    They replace those of an earlier simulation or, with `overwrite`, any file.
    """
    content = {"schema_version": 1, "surveys": [one.to_json() for one in tried]}
    write_json(file, content, OWN_KEYS, overwrite=overwrite)


def format_simulation(one: SimulationResult) -> str:
    """The figures as plain text."""
    s = one.survey
    given = "poses given" if s.pose_m is not None else "spacing given"
    lines = [
        f"images every {s.spacing_m:.2f} m, {given}; focal length {s.focal_px:.0f} px ({view_of_focal(s):.0f} degrees)",
        f"signs {abs(s.lateral_m):.1f} m beside the camera, seen last from {np.median(one.nearest):.1f} m",
        f"placed {len(one.error)} of {one.wanted} signs",
        "",
        f"{'error, m':<10}{'median':>9}{'68 %':>9}{'95 %':>9}"
        f"{'sigma':>9}{'bound':>9}{'in 1 sigma':>12}{'in 2 sigma':>12}",
    ]
    for k, axis in enumerate(AXES):
        *metres, one_sigma, two_sigma = one.figures(k).values()
        lines.append(
            f"{axis:<10}{_cells(metres)}{100 * one_sigma:10.0f} %{100 * two_sigma:10.0f} %"
        )
    lines += [f"{'total':<10}{_cells(_quantiles(one.total).values())}", ""]
    lines += [
        "sigma: as stated with each sign; bound: Cramér-Rao, the least that any method",
        "could reach (both 68 %)",
    ]
    return "\n".join(lines)


def sweep_heading(target_m: float) -> str:
    """Lines above the rows of a sweep."""
    return (
        f"95 % of the signs within {target_m:g} m:\n"
        f"{'spacing, m':>10}{'focal, px':>11}{'view':>6}{'placed':>10}{'median':>9}{'95 %':>9}{'bound':>9}"
    )


def sweep_row(one: SimulationResult, target_m: float) -> str:
    """The line of one combination, marked where it reaches the target."""
    s, bound = one.survey, float(np.median(np.linalg.norm(one.bound, axis=1)))
    return (
        f"{s.spacing_m:>10.2f}{s.focal_px:>11.0f}{view_of_focal(s):>5.0f}°{len(one.error):>6}/{one.wanted:<3}"
        f"{np.median(one.total):>9.3f}{np.quantile(one.total, 0.95):>9.3f}{bound:>9.3f}"
        f"{'   reached' if reaches(one, target_m) else ''}"
    )


def sweep_conclusion(tried: Sequence[SimulationResult], target_m: float) -> str:
    """Lines below the rows of a sweep."""
    if good := [one.survey.spacing_m for one in tried if reaches(one, target_m)]:
        return f"\nwidest spacing that reaches it: {max(good):.2f} m"
    return "\nnone of these reaches it: closer signs, less noise or given poses would help"


def _bounds(drive: SimulatedDrive, signs: Sequence[int]) -> Array:
    """Bounds (n, 3) of signs as standard deviations along, lateral, up."""
    survey = drive.survey
    steps = np.full((len(drive.poses), 6, 6), np.nan)
    offset = np.diag([(survey.face_share * survey.panel_m) ** 2] * 2 + [0.0])
    given = None if survey.pose_m is None else (survey.pose_m, radians(survey.pose_deg))
    result = np.empty((len(signs), 3))
    for i, sign in enumerate(signs):
        frames = np.flatnonzero([sign in seen.sign for seen in drive.seen])
        span = np.arange(frames[0], frames[-1] + 1)
        for frame in span[1:]:
            if np.isnan(steps[frame, 0, 0]):
                steps[frame] = _step_bound(drive, int(frame))
        depth = [drive.depth(int(f), drive.signs[[sign]])[0] for f in frames]
        tall = survey.panel_m / np.array(depth)
        covariance = point_bound(
            np.stack([drive.poses[f].rotation for f in span]),
            np.stack([drive.poses[f].centre for f in span]),
            drive.signs[sign],
            frames - span[0],
            survey.noise_px / survey.focal_px + survey.noise_share * tall,
            steps[span],
            len(span) - 1,
            given,
        )
        result[i] = np.sqrt(np.diag(covariance + offset))[_ORDER]
    return result


def bound_of_step(
    survey: Survey, camera: Camera, step: Pose, pixels: tuple[Array, Array], sigma_m: float
) -> Array:
    """Smallest covariance (6, 6) of a step by ties at these ideal pixels (n, 2) of both images.

    Errors of the ties as in the survey; `sigma_m`: standard deviation of the step's length beforehand.
    """
    baseline = float(np.linalg.norm(step.centre))
    direction = np.ascontiguousarray(step.centre / baseline)
    previous, current = (rays_of_ideal(camera, uv) for uv in pixels)
    focal = 0.5 * (camera.fx + camera.fy)
    jacobian = motion_jacobian(previous, current, step.rotation, direction, focal)
    toward = step.rotation.T @ direction
    outward = current - toward[:2] / toward[2]
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    apart = ((pixels[1][:, None] - pixels[1][None]) ** 2).sum(axis=2)
    shared = np.exp(-apart / (2 * survey.tie_drift_reach_px**2)) * (outward @ outward.T)
    # the drift is in one of the two images, between which the Sampson distance divides the error
    drift = survey.drift_of(camera, step, *pixels)
    covariance = survey.tie_px**2 * np.eye(len(jacobian)) + 0.5 * shared * np.outer(drift, drift)
    covariance += 1e-12 * np.eye(len(jacobian))
    return step_bound(jacobian, covariance, direction, baseline, sigma_m)


def _step_bound(drive: SimulatedDrive, frame: int) -> Array:
    survey = drive.survey
    points = drive.points[drive.common(frame - 1, frame)]
    pixels = drive.project(frame - 1, points), drive.project(frame, points)
    step = drive.poses[frame].relative_to(drive.poses[frame - 1])
    known = survey.trigger_m if survey.pose_m is None else UNKNOWN_LENGTH_M
    return bound_of_step(survey, drive.camera, step, pixels, known)


def _quantiles(errors: Array) -> dict[str, float]:
    found = np.quantile(np.abs(errors), [0.5, 0.6827, 0.95]).tolist()
    return dict(zip(("median_m", "p68_m", "p95_m"), found, strict=True))


def _cells(metres: Iterable[float]) -> str:
    return "".join(f"{value:9.3f}" for value in metres)
