"""Which stream of a log gives the camera's motion: one that the images do not contradict."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.pipeline.reading.clocks import Floats, Integers
from wayside.pipeline.reading.h264 import H264
from wayside.pipeline.reading.plan import Plan
from wayside.pipeline.reading.video import CameraImages, decoded_images
from wayside.schemas.frame import Camera
from wayside.schemas.settings import FeatureSettings, MotionSettings
from wayside.stages.odometry import (
    AXES,
    Agreement,
    CameraPath,
    ImageStep,
    KeypointImage,
    agreement,
    image_step,
    tie_corners,
    upright,
)

_STEPS, _SHORTEST_S, _DOUBLINGS = 14, 0.08, 4
"""Pairs of images spread over a drive; their distance grows from 0.08 s until they show motion."""
_FIRST_STEPS = 5
"""Where all of so many agree with the preferred poses, the others would: steps of sound poses do nearly always."""
_CLEARLY_BETTER = 2.5
"""One convention is chosen over another if its error is so many times smaller."""
_LONGEST_LAG_S, _FURTHEST_LAG_S, _LAG_DEG = 1.0, 6.0, 0.2
"""Shorter lags are found when the path is smoothed; errors of sound poses are a tenth of a degree a step."""
_VIDEO_IMAGES = 40
"""A video is decoded from its start: its first images are compared. Corners of so many images are kept."""


@dataclass(frozen=True, slots=True)
class MotionStream:
    """Poses at all images: `raw` as recorded, `path` with the mount of the camera; sigma (k, 3) as recorded."""

    source: str
    topic: str
    words: str
    raw: CameraPath
    path: CameraPath
    sigma: Floats
    assumed_mount: bool = False


def _lag_s(
    path: CameraPath, steps: Sequence[ImageStep], order: Integers, time_ns: Integers
) -> float:
    """How long after an image poses turn as it does, seconds; 0 where this is less than `_LONGEST_LAG_S` or not clear.

    The angle of a step does not depend on axes or mounts. A straight road tells nothing.
    """
    if not steps:
        return 0.0
    pairs = np.argsort(order)[[(step.first, step.second) for step in steps]]
    shown = _angles_deg(np.array([step.rotation for step in steps]))
    seconds = (time_ns[order] - time_ns[order[0]]) * 1e-9
    each_s = max(float(seconds[-1]) / max(len(order) - 1, 1), _FURTHEST_LAG_S / 200)
    errors: dict[float, float] = {}
    for shift in range(-round(_FURTHEST_LAG_S / each_s), round(_FURTHEST_LAG_S / each_s) + 1):
        moved = (pairs + shift).clip(0, len(order) - 1)
        first, second = order[moved].T
        known = (moved == pairs + shift).all(axis=1) & path.known[first] & path.known[second]
        if 2 * known.sum() > len(steps):
            turned = _angles_deg(path.rotation[first].transpose(0, 2, 1) @ path.rotation[second])
            lag_s = float(np.median((seconds[moved] - seconds[pairs])[known]))
            errors[lag_s] = float(np.median(np.abs(turned - shown)[known]))
    best = min(errors, key=lambda lag_s: errors[lag_s], default=0.0)
    here = errors.get(0.0, np.inf)
    clear = here > _CLEARLY_BETTER * errors.get(best, np.inf) and here > _LAG_DEG
    return best if clear and abs(best) > _LONGEST_LAG_S else 0.0


def _angles_deg(rotations: Floats) -> Floats:
    return np.asarray(np.degrees(Rotation.from_matrix(rotations).magnitude()))


def believed(
    streams: Sequence[MotionStream],
    steps: list[ImageStep],
    order: Integers,
    time_ns: Integers,
    notes: list[str],
) -> MotionStream | None:
    """The first stream that the images do not contradict, as it is or after one known conversion.

    `notes`: filled with what was converted, and what is left out and why.
    """
    for stream in streams:
        if lag_s := _lag_s(stream.raw, steps, order, time_ns):
            notes.append(
                f"the {stream.words} are left out: they turn like the images, but {abs(lag_s):.1f} s "
                f"{'later' if lag_s > 0 else 'earlier'}; correct their times"
            )
            continue
        found, (path, up) = agreement(steps, stream.path), upright(stream.path)
        converted = list(_conversions(stream, steps))
        least = _CLEARLY_BETTER * min((c.found.error_deg for c in converted), default=np.inf)
        if not found.tells or (up and found.agrees and found.error_deg <= least):
            if stream.assumed_mount:
                notes.append(
                    "the log does not say how the camera is mounted: it is assumed to look straight ahead"
                )
            notes += _world_words(stream, up) if found.tells else []
            return replace(stream, path=path) if found.tells else stream
        like = [one for one in converted if one.found.error_deg < least]
        level = [one for one in like if one.up == "z"] or like
        if len(level) == 1:
            notes.append(f"the {stream.words} are {level[0].words}: they are used as such")
            return replace(stream, path=level[0].path)
        notes.append(_left_out_words(stream, found, len(level)))
    return None


def believed_motion(
    streams: Sequence[MotionStream], found: Iterator[ImageStep], order: Integers, time_ns: Integers
) -> tuple[MotionStream | None, list[ImageStep], list[str]]:
    """What is `believed` by a few of the steps `found` where all agree with the first stream, else by all of them."""
    steps, notes, motion = list(islice(found, _FIRST_STEPS)), list[str](), None
    if agreement(steps, streams[0].path).agree == _FIRST_STEPS:
        motion = believed(streams[:1], steps, order, time_ns, notes)
    if motion is None:
        notes.clear()
        steps += found
        motion = believed(streams, steps, order, time_ns, notes)
    return motion, steps, notes


def looks_aside(steps: list[ImageStep]) -> bool:
    """Whether the camera travels across its optical axis."""
    return len(steps) > 2 and float(np.median([abs(s.direction[2]) for s in steps])) < 0.5


class _Conversion(NamedTuple):
    """Poses after one known conversion, and how these agree with the images."""

    words: str
    path: CameraPath
    up: str
    found: Agreement


def _conversions(stream: MotionStream, steps: list[ImageStep]) -> Iterator[_Conversion]:
    """Known conventions after which poses agree with the images, in a world whose z axis is up.

    Of other worlds only one is known with other axes: that of vehicles whose z axis is down, too.
    """
    ways = [
        (f"of a vehicle ({name}), not of the camera", stream.raw.mounted(axes))
        for name, axes in AXES.items()
    ]
    ways += [
        ("of the camera itself", stream.raw),
        ("the world in the camera, not the camera in the world", stream.raw.inverted()),
    ]
    for words, path in ways:
        turned, up = upright(path)
        found = agreement(steps, turned)
        known = up in ("z", "earth") or (up == "-z" and "z down" in words)
        if known and found.tells and found.agrees:
            yield _Conversion(words, turned, up, found)


def _world_words(stream: MotionStream, up: str) -> list[str]:
    if up == "z":
        return []
    was = {
        "earth": "is centred on the earth",
        "-z": "has z down (north, east, down)",
        "-y": "has y down, as a camera has",
    }.get(up, f"has {up} up")
    return [f"the world of the {stream.words} {was}: it is turned so that z is up"]


def _left_out_words(stream: MotionStream, found: Agreement, ways: int) -> str:
    if not found.agrees:
        reason = (
            f"they contradict the images: {found.steps - found.agree} of {found.steps} steps differ, the direction of "
            f"travel by {found.direction_deg:.0f} degrees, the rotation by {found.rotation_deg:.1f} (medians)"
        )
    else:
        reason = "the camera would lie on its side in them"
    several = " and fit after several conversions" if ways > 1 else ""
    return (
        f"the {stream.words} are left out: {reason}{several}; record poses of the camera, or a transform that "
        "mounts it"
    )


def image_steps(
    plan: Plan, order: Integers, time_ns: Integers, cameras: Sequence[Camera | None]
) -> Iterator[ImageStep]:
    """Motion between pairs of images spread over a drive, from the images alone; every third pair first."""
    kept: dict[int, KeypointImage | None] = {}
    images = CameraImages(plan.other_cameras)

    def corners_at(rows: Integers) -> list[KeypointImage | None]:
        """Corners of images, None where one cannot be used; the latest few are kept."""
        new = np.array([row for row in rows.tolist() if row not in kept], np.int64)
        for row, image in decoded_images(plan, new, cameras, images):
            kept[row], camera = None, cameras[row]
            if camera is not None and image.grey is not None:
                corners = tie_corners(image.grey, FeatureSettings())
                kept[row] = KeypointImage.of_corners(camera, image.grey, *corners)
        found = [kept.get(row) for row in rows.tolist()]
        while len(kept) > _VIDEO_IMAGES:
            del kept[next(iter(kept))]
        return found

    if plan.camera.image_format == H264:
        order = order[:_VIDEO_IMAGES]
        corners_at(order)
    seconds = (time_ns[order] - time_ns[order[0]]) * 1e-9
    starts = np.unique(np.linspace(0, max(len(order) - 2, 0), _STEPS).astype(int)).tolist()
    for start in (*starts[::3], *starts[1::3], *starts[2::3]):
        apart = _SHORTEST_S
        for _ in range(_DOUBLINGS):
            end = max(start + 1, int(np.searchsorted(seconds, seconds[start] + apart)))
            if end >= len(order):
                break
            rows = order[[start, end]]
            before, now = corners_at(rows)
            if before is None or now is None:
                break
            step = image_step((int(rows[0]), int(rows[1])), before, now, MotionSettings())
            if step is not None:
                yield step
                break
            apart = max(2 * apart, float(seconds[end] - seconds[start]) * 1.01)
