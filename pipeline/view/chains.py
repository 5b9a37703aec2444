"""What is known at the end of a drive: every sign with its views, rays and residuals, the table, the map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.code_words import code_of
from wayside.pipeline.results.inventory import WrittenTables
from wayside.pipeline.view import entities as at
from wayside.pipeline.view.entities import Batch, Columns, Entity, Times
from wayside.pipeline.view.landmarks import (
    GREY,
    MARK,
    THIN,
    cross_section,
    face_in_image,
    landmark_color,
    landmark_words,
    panel_rotation,
)
from wayside.pipeline.view.views import AFTER, BEFORE, ITERATIONS_SHOWN, ViewState
from wayside.schemas.detections import SOURCES, Dropped
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.landmarks import Landmark
from wayside.schemas.models import GaussianModel

SIGMAS = 2.0
"""Ellipsoids and ellipses are drawn at so many standard deviations."""
STEPS = ["at the start", *(f"after step {k + 1}" for k in range(ITERATIONS_SHOWN))]
GATE_NAMES = {
    **dict.fromkeys(
        ("segment", "propose"), (*SOURCES, *(f"dropped, {reason}" for reason in Dropped._fields))
    ),
    **dict.fromkeys(("color", "detect", "shape"), ("kept", "refused")),
    **dict.fromkeys(("track", "trajectory", "location", "assemble"), ("signs first seen",)),
}
"""What the numbers of a stage are, in the order in which its view gives them."""
LEAST_HALF_AXIS_M = 0.02
WHITE = (255, 255, 255)


def opening(location: GaussianModel) -> Batch:
    """What holds for the whole drive: axes of the world, ellipses of the location model."""
    found = [Entity(at.WORLD, (rr.ViewCoordinates.RDF,))]
    for one in location.classes:
        # The plane across the road as an image: right is right, up is up (images count downwards).
        ring = ellipse(one.mean, one.covariance, one.threshold) * (1.0, -1.0)
        strip = rr.LineStrips2D([ring], colors=[GREY], labels=[one.name], radii=THIN)
        found.append(Entity(f"{at.LOCATION}/{one.name}", (strip,)))
    found.append(Entity(at.ITERATIONS, (rr.SeriesLines(names=STEPS),)))
    for stage, names in GATE_NAMES.items():
        found.append(
            Entity(f"{at.GATES}/{stage}", (rr.SeriesLines(names=[f"{stage}: {n}" for n in names]),))
        )
    for name, ink in (("straight", BEFORE), ("adjusted", AFTER)):
        found.append(
            Entity(f"{at.RESIDUALS}/{name}", (rr.SeriesLines(colors=[ink], names=[name]),))
        )
    for name, ink in (("before", BEFORE), ("after", AFTER)):
        found.append(
            Entity(f"{at.WINDOW_RESIDUALS}/{name}", (rr.SeriesPoints(colors=[ink], names=[name]),))
        )
    return Batch(None, tuple(found))


def ellipse(
    mean: NDArray[np.float64], covariance: NDArray[np.float64], distance: float
) -> NDArray[np.float64]:
    """Points (65, 2) at a Mahalanobis distance from a mean (2,) with covariance (2, 2)."""
    angle = np.linspace(0, 2 * np.pi, 65)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(mean + distance * (np.linalg.cholesky(covariance) @ circle).T, np.float64)


def closing(
    inventory: WrittenTables,
    state: ViewState,
    times: Mapping[int, Times],
) -> Iterator[Batch | Columns]:
    """What is known at the end of the drive only, sign by sign."""
    yield Batch(None, tuple(_table_and_map(inventory)))
    yield from _names(inventory, times)
    for row, sign in zip(inventory.sign_rows, inventory.signs, strict=True):
        name = " ".join(filter(None, (row["sign_id"], code_of(row))))
        yield from chain(row["sign_id"], name, sign.landmark, state.poses, times)
        figures = rr.TextDocument(sign_figures(row), media_type="text/markdown")
        part = rr.escape_entity_path_part(row["sign_id"])
        measured = state.measured.get(sign.landmark.track_id)
        shown = () if measured is None else measured.entities(part)
        yield Batch(None, (Entity(f"{at.SIGN_FIGURES}/{part}", (figures,)), *shown))


def _names(inventory: WrittenTables, times: Mapping[int, Times]) -> Iterator[Batch | Columns]:
    """Every sign marked in its colour; in white the names of all, and frame by frame of those in view.

    Panels of one assembly share a name, which would lie on each other. The viewer writes a label in the colour of its
    point, and brown or blue words are not readable on a dark ground: names are points of their own.
    """
    if not inventory.signs or not times:
        return
    landmarks = [sign.landmark for sign in inventory.signs]
    centres = np.array([one.best_pose.to_world(one.position) for one in landmarks])
    marks = rr.Points3D(centres, colors=[landmark_color(one) for one in landmarks], radii=MARK)
    panels: dict[str, list[int]] = {}
    for i, row in enumerate(inventory.sign_rows):
        panels.setdefault(row["assembly_id"], []).append(i)
    words = [
        ", ".join(sign_name(inventory.sign_rows[i]) for i in group) for group in panels.values()
    ]
    places = np.array([centres[group].mean(axis=0) for group in panels.values()])
    names = rr.Points3D(places, colors=[WHITE], labels=words, show_labels=True, radii=THIN)
    shared = rr.Points3D.from_fields(colors=[WHITE], show_labels=True, radii=THIN)
    named = (Entity(at.NAMES, (names,)), Entity(at.NAMES_IN_VIEW, (shared,)))
    yield Batch(None, (Entity(at.MARKS, (marks,)), *named))
    seen = [[landmarks[i].views for i in group] for group in panels.values()]
    spans = [(min(v[0].frame for v in one), max(v[-1].frame for v in one)) for one in seen]
    frames = sorted(times)
    shown = [[i for i, (a, b) in enumerate(spans) if a <= frame <= b] for frame in frames]
    rows = [i for in_frame in shown for i in in_frame]
    columns = rr.Points3D.columns(
        positions=places[rows].reshape(-1, 3),
        labels=[words[i] for i in rows],
    ).partition([len(in_frame) for in_frame in shown])
    yield Columns(at.NAMES_IN_VIEW, tuple(times[frame] for frame in frames), tuple(columns))


def sign_name(row: Mapping[str, Any]) -> str:
    """Number and code of a sign, as it is labelled in space; colour and shape where it has no code.

    Short, as the names of signs that stand behind each other lie on each other.
    """
    what = code_of(row) or " ".join(_appearance(row))
    return f"{row['sign_id'].rpartition('-')[2]} {what}"


def chain(
    sign_id: str,
    name: str,
    landmark: Landmark,
    poses: Mapping[int, tuple[Pose, Camera]],
    times: Mapping[int, Times],
) -> Iterator[Batch | Columns]:
    """One sign, labelled `name`: its ellipsoid and panel, a ray a view, boxes and residuals where it was measured."""
    ink = landmark_color(landmark)
    centre = landmark.best_pose.to_world(landmark.position)
    part = rr.escape_entity_path_part(sign_id)
    views = [view for view in landmark.views if view.frame in poses and view.frame in times]
    rays = [np.stack([poses[view.frame][0].centre, centre]) for view in views]
    words = f"{name}: {landmark_words(landmark)}"
    yield Batch(
        None,
        (
            Entity(f"{at.SIGNS}/{part}", (_panel(landmark, centre, ink, words),)),
            Entity(f"{at.SIGNS}/{part}/error", (_ellipsoid(landmark, centre, ink),)),
            Entity(f"{at.SIGN_RAYS}/{part}", (rr.LineStrips3D(rays, colors=[ink], radii=THIN),)),
        ),
    )
    if not views:
        return
    when = tuple(times[view.frame] for view in views)
    boxes = np.array([view.box for view in views])
    measured = rr.Boxes2D.columns(
        centers=(boxes[:, 2:] + boxes[:, :2]) / 2,
        half_sizes=(boxes[:, 2:] - boxes[:, :2]) / 2,
        colors=[ink] * len(views),
    )
    reprojected = rr.LineStrips2D.columns(
        strips=[face_in_image(landmark, *poses[view.frame]) for view in views],
        colors=[WHITE] * len(views),
    )
    for name, columns in (("measured", measured), ("reprojected", reprojected)):
        yield Columns(f"{at.CHAINS}/{part}/{name}", when, tuple(columns))
        yield from _cleared(f"{at.CHAINS}/{part}/{name}", when, times)
    residuals = rr.Scalars.columns(scalars=[view.residual_px for view in views])
    yield Columns(f"{at.SIGN_RESIDUALS}/{part}", when, tuple(residuals))


def _cleared(path: str, when: Sequence[Times], times: Mapping[int, Times]) -> Iterator[Batch]:
    """Clear a chain in frames between and after its views, so that no box is shown where nothing was measured."""
    measured_in = {t.frame for t in when}
    for frame in sorted(measured_in):
        after = frame + 1
        if after not in measured_in and after in times:
            yield Batch(times[after], (Entity(path, (rr.Clear(recursive=False),)),))


def _panel(
    landmark: Landmark, centre: NDArray[np.float64], ink: tuple[int, int, int], words: str
) -> rr.Boxes3D:
    size = np.array([landmark.width_m, landmark.height_m, 0.03])
    return rr.Boxes3D(
        centers=[centre],
        half_sizes=[size / 2],
        quaternions=[rr.Quaternion(xyzw=_quaternion(panel_rotation(landmark)))],
        colors=[ink],
        fill_mode=rr.components.FillMode.Solid,
        labels=[words],
        show_labels=False,
    )


def _ellipsoid(
    landmark: Landmark, centre: NDArray[np.float64], ink: tuple[int, int, int]
) -> rr.Ellipsoids3D:
    square, axes = np.linalg.eigh(landmark.covariance)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    half = np.maximum(SIGMAS * np.sqrt(np.maximum(square, 0.0)), LEAST_HALF_AXIS_M)
    return rr.Ellipsoids3D(
        centers=[centre],
        half_sizes=[half],
        quaternions=[rr.Quaternion(xyzw=_quaternion(landmark.best_pose.rotation @ axes))],
        colors=[(*ink, 120)],
    )


def _quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(Rotation.from_matrix(rotation).as_quat())


def _table_and_map(inventory: WrittenTables) -> Iterator[Entity]:
    signs, landmarks = inventory.sign_rows, [sign.landmark for sign in inventory.signs]
    document = rr.TextDocument(inventory_table(signs), media_type="text/markdown")
    yield Entity(at.INVENTORY, (document,))
    names = [row["sign_id"] for row in signs]
    yield Entity(f"{at.LOCATION}/signs", (cross_section(landmarks, names),))
    if inventory.path.globe is None:
        return
    route = inventory.path.globe.route()[:, [1, 0]]
    yield Entity(f"{at.MAP}/route", (rr.GeoLineStrings(lat_lon=[route]),))
    if signs:
        points = rr.GeoPoints(
            lat_lon=[(row["lat_deg"], row["lon_deg"]) for row in signs],
            colors=[landmark_color(landmark) for landmark in landmarks],
            radii=rr.Radius.ui_points(6),
        )
        yield Entity(f"{at.MAP}/signs", (points,))


def sign_figures(row: Mapping[str, Any]) -> str:
    """One sign's row as a markdown table of two columns."""
    lines = [
        f"# {row['sign_id']}: {' '.join(filter(None, (code_of(row), *_appearance(row))))}",
        "",
        "| | |",
        "|---|---|",
    ]
    for name, value in row.items():
        if value is None or isinstance(value, (list, bytes)) or name in ("sign_id", "log"):
            continue
        lines.append(
            f"| {name} | {value:.3f} |" if isinstance(value, float) else f"| {name} | {value} |"
        )
    return "\n".join(lines) + "\n"


def inventory_table(signs: Sequence[Mapping[str, Any]]) -> str:
    """The signs as a markdown table."""
    head = "| sign | code | colour | shape | station m | right m | up m | width m | height m | ± along m"
    rule = "|---|---|---|---|--:|--:|--:|--:|--:|--:|--:|--:|"
    lines = [f"# {len(signs)} signs", "", f"{head} | views | confidence |", rule]
    for row in signs:
        numbers = [
            _number(row[name])
            for name in (
                *("station_m", "lateral_m", "up_m", "panel_width_m", "panel_height_m"),
                "sigma_along_m",
            )
        ]
        cells = (row["sign_id"], code_of(row) or "", *_appearance(row), *numbers)
        lines.append(f"| {' | '.join(cells)} | {row['views']} | {_number(row['confidence'])} |")
    return "\n".join(lines) + "\n"


def _appearance(row: Mapping[str, Any]) -> tuple[str, str]:
    """Colour and shape in words; a back has no colour."""
    color = "back" if row["status"] == "back" else (row["color"] or "?").replace("_", " ")
    return color, row["shape"] or "?"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
