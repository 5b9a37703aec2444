"""Entities of a whole drive: axes and series at its start; at its end the signs, with views, rays and residuals."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.code_words import code_of, posts_words
from wayside.pipeline.results.inventory import WrittenTables
from wayside.pipeline.results.rows import posts_rows
from wayside.pipeline.view import entities as at
from wayside.pipeline.view.drawing import (
    GREY,
    THIN,
    WHITE,
    across_the_road,
    centre_of,
    cross_section,
    face_in_image,
    landmark_color,
    landmark_words,
    panel_rotation,
)
from wayside.pipeline.view.entities import Batch, Entity, Times, cleared
from wayside.pipeline.view.views import AFTER, BEFORE, ITERATIONS_SHOWN, ViewState
from wayside.schemas.detections import SOURCES, Dropped
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
    **dict.fromkeys(
        ("track", "trajectory", "location", "points", "panels", "assemble"), ("signs first seen",)
    ),
}
"""Names of a stage's numbers, in the order in which its view gives them."""
Signs = Sequence[Mapping[str, Any]]
"""Of `signs.parquet`."""
MARK = rr.Radius.ui_points(6)
"""Of a landmark in space: on the screen the same from any distance, where a panel of 0.7 m is a few pixels."""
LEAST_HALF_AXIS_M = 0.02
GROUND_INK = (150, 110, 60)


def opening(location: GaussianModel) -> Batch:
    """What holds for the whole drive: axes of the world, ellipses of the location model, names of series."""
    found = [Entity(at.WORLD, rr.ViewCoordinates.RDF)]
    for one in location.classes:
        ring = across_the_road(_ellipse(one.mean, one.covariance))
        strip = rr.LineStrips2D([ring], colors=[GREY], labels=[one.name], radii=THIN)
        found.append(Entity(f"{at.LOCATION}/{one.name}", strip))
    found.append(Entity(at.ITERATIONS, rr.SeriesLines(names=STEPS)))
    for stage, names in GATE_NAMES.items():
        lines = rr.SeriesLines(names=[f"{stage}: {name}" for name in names])
        found.append(Entity(f"{at.GATES}/{stage}", lines))
    for line, dot, ink in (("straight", "before", BEFORE), ("adjusted", "after", AFTER)):
        lines = rr.SeriesLines(colors=[ink], names=[line])
        dots = rr.SeriesPoints(colors=[ink], names=[dot])
        found.append(Entity(f"{at.RESIDUALS}/{line}", lines))
        found.append(Entity(f"{at.WINDOW_RESIDUALS}/{dot}", dots))
    return Batch(None, tuple(found))


def _ellipse(mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (65, 2) at `SIGMAS` from a mean (2,) with covariance (2, 2)."""
    angle = np.linspace(0, 2 * np.pi, 65)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray(mean + SIGMAS * (np.linalg.cholesky(covariance) @ circle).T, np.float64)


def closing(
    inventory: WrittenTables, state: ViewState, times: Mapping[int, Times]
) -> Iterator[Batch]:
    """Entities that are known only at the end of the drive: the table, the map, and each sign."""
    rows = inventory.sign_rows
    yield Batch(None, tuple(_table_and_map(inventory, rows)))
    yield Batch(None, tuple(_ground(inventory, state)))
    if rows and times:
        yield from _names(rows, [sign.landmark for sign in inventory.signs], times)
    for row, sign in zip(rows, inventory.signs, strict=True):
        part = rr.escape_entity_path_part(row["sign_id"])
        name = " ".join(filter(None, (row["sign_id"], code_of(row))))
        yield from _chain(part, name, sign.landmark, state, times)
        figures = rr.TextDocument(sign_figures(row), media_type="text/markdown")
        found = [Entity(f"{at.SIGN_FIGURES}/{part}", figures)]
        pictures, history = state.measured.get(sign.landmark.track_id, ({}, ()))
        found += [Entity(f"{at.SIGN_PANELS}/{part}/{name}", one) for name, one in pictures.items()]
        if history:
            found.append(Entity(f"{at.SIGN_ITERATIONS}/{part}", rr.BarChart(np.array(history))))
        yield Batch(None, tuple(found))


def _table_and_map(inventory: WrittenTables, signs: Signs) -> Iterator[Entity]:
    landmarks = [sign.landmark for sign in inventory.signs]
    posts = [] if inventory.sections is None else posts_rows(inventory.signs, inventory.log)
    table = rr.TextDocument(inventory_table(signs, posts), media_type="text/markdown")
    yield Entity(at.INVENTORY, table)
    yield Entity(f"{at.LOCATION}/signs", cross_section(landmarks, [r["sign_id"] for r in signs]))
    if inventory.path.globe is None:
        return
    route = inventory.path.globe.route()[:, [1, 0]]
    yield Entity(f"{at.MAP}/route", rr.GeoLineStrings(lat_lon=[route]))
    if signs:
        places = [(row["lat_deg"], row["lon_deg"]) for row in signs]
        inks = [landmark_color(landmark) for landmark in landmarks]
        yield Entity(f"{at.MAP}/signs", rr.GeoPoints(lat_lon=places, colors=inks, radii=MARK))


def _ground(inventory: WrittenTables, state: ViewState) -> Iterator[Entity]:
    """The cross-sections of the road: the measured ground, and in grey what plants or rails hide."""
    strips: list[Any] = []
    marks: list[Any] = []
    for one in inventory.sections or ():
        if one.frame not in state.poses:
            continue
        local = inventory.path.poses[one.frame].to_camera(one.points)
        points, status = state.poses[one.frame][0].to_world(local), np.array(one.status)
        marks.append(points[status == "hidden"])
        runs = np.split(np.arange(len(points)), np.flatnonzero(status != "ground"))
        strips += [points[run[status[run] == "ground"]] for run in runs]
    if not marks:
        return
    shown = [strip for strip in strips if len(strip) > 1]
    yield Entity(f"{at.GROUND}/measured", rr.LineStrips3D(shown, colors=[GROUND_INK], radii=THIN))
    hidden = rr.Points3D(np.concatenate(marks), colors=[GREY], radii=THIN)
    yield Entity(f"{at.GROUND}/hidden", hidden)


def _names(signs: Signs, landmarks: list[Landmark], times: Mapping[int, Times]) -> Iterator[Batch]:
    """Every sign marked in its colour; in white the names of all, and frame by frame of those in view.

    Panels of one assembly share a name, which would lie on each other. The viewer writes a label in the colour of its
    point, and brown or blue words are not readable on a dark ground: names are points of their own. Rows without a
    confidence are too many to be named: their names and residuals show under the pointer.
    """
    centres = np.array([centre_of(one) for one in landmarks])
    inks = [landmark_color(one) for one in landmarks]
    panels: dict[str, list[int]] = {}
    for i, row in enumerate(signs):
        panels.setdefault(row["assembly_id"], []).append(i)
    words = [", ".join(sign_name(signs[i]) for i in own) for own in panels.values()]
    places = np.array([centres[own].mean(axis=0) for own in panels.values()])
    first = np.array([min(signs[i]["first_frame"] for i in own) for own in panels.values()])
    last = np.array([max(signs[i]["last_frame"] for i in own) for own in panels.values()])

    def named(rows: NDArray[np.intp]) -> rr.Points3D:
        spots, labels = places[rows], [words[i] for i in rows]
        return rr.Points3D(spots, colors=[WHITE], labels=labels, show_labels=True, radii=THIN)

    pairs = zip(signs, landmarks, strict=True)
    hidden = [f"{sign_name(row)}, residual {one.residual_px:.2f} px" for row, one in pairs]
    points = rr.Points3D(centres, colors=inks, radii=MARK, labels=hidden, show_labels=False)
    yield Batch(None, (Entity(at.MARKS, points),))
    if np.isnan([one.score for one in landmarks]).all():
        return
    yield Batch(None, (Entity(at.NAMES, named(np.arange(len(words)))),))
    for frame in sorted(times):
        shown = named(np.flatnonzero((first <= frame) & (frame <= last)))
        yield Batch(times[frame], (Entity(at.NAMES_IN_VIEW, shown),))


def sign_name(row: Mapping[str, Any]) -> str:
    """Number and code of a sign, as it is labelled in space; colour and shape where it has no code.

    Short, as the names of signs that stand behind each other lie on each other.
    """
    what = code_of(row) or " ".join(_appearance(row))
    return f"{row['sign_id'].rpartition('-')[2]} {what}"


def _chain(
    part: str, name: str, landmark: Landmark, state: ViewState, times: Mapping[int, Times]
) -> Iterator[Batch]:
    """One sign, labelled `name`: its ellipsoid and panel, a ray a view, boxes and residuals where it was measured.

    A chain is cleared in frames between and after its views, so that no box is shown where nothing was measured.
    """
    ink = landmark_color(landmark)
    centre = centre_of(landmark)
    views = {v.frame: v for v in landmark.views if v.frame in state.poses and v.frame in times}
    rays = [np.stack([state.poses[frame][0].centre, centre]) for frame in views]
    solid = (
        Entity(f"{at.SIGNS}/{part}", _panel(landmark, f"{name}: {landmark_words(landmark)}")),
        Entity(f"{at.SIGNS}/{part}/error", _ellipsoid(landmark)),
        Entity(f"{at.SIGN_RAYS}/{part}", rr.LineStrips3D(rays, colors=[ink], radii=THIN)),
    )
    yield Batch(None, solid)
    paths = [f"{at.CHAINS}/{part}/{name}" for name in ("measured", "reprojected")]
    for frame, view in views.items():
        box = rr.Boxes2D(array=[view.box], array_format=rr.Box2DFormat.XYXY, colors=[ink])
        face = rr.LineStrips2D([face_in_image(landmark, *state.poses[frame])], colors=[WHITE])
        residual = Entity(f"{at.SIGN_RESIDUALS}/{part}", rr.Scalars([view.residual_px]))
        yield Batch(times[frame], (Entity(paths[0], box), Entity(paths[1], face), residual))
        if frame + 1 not in views and frame + 1 in times:
            yield Batch(times[frame + 1], tuple(cleared(path) for path in paths))


def _panel(landmark: Landmark, words: str) -> rr.Boxes3D:
    size = np.array([landmark.width_m, landmark.height_m, 0.03])
    return rr.Boxes3D(
        centers=[centre_of(landmark)],
        half_sizes=[size / 2],
        quaternions=[_quaternion(panel_rotation(landmark))],
        colors=[landmark_color(landmark)],
        fill_mode=rr.components.FillMode.Solid,
        labels=[words],
        show_labels=False,
    )


def _ellipsoid(landmark: Landmark) -> rr.Ellipsoids3D:
    square, axes = np.linalg.eigh(landmark.covariance)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    half = np.maximum(SIGMAS * np.sqrt(np.maximum(square, 0.0)), LEAST_HALF_AXIS_M)
    return rr.Ellipsoids3D(
        centers=[centre_of(landmark)],
        half_sizes=[half],
        quaternions=[_quaternion(landmark.best_pose.rotation @ axes)],
        colors=[(*landmark_color(landmark), 120)],
    )


def _quaternion(rotation: NDArray[np.float64]) -> rr.Quaternion:
    return rr.Quaternion(xyzw=Rotation.from_matrix(rotation).as_quat())


def sign_figures(row: Mapping[str, Any]) -> str:
    """One sign's row as a markdown table of two columns."""
    look = " ".join(filter(None, (code_of(row), *_appearance(row))))
    lines = [f"# {row['sign_id']}: {look}", "", "| | |", "|---|---|"]
    for name, value in row.items():
        if value is None or isinstance(value, (list, bytes)) or name in ("sign_id", "log"):
            continue
        shown = f"{value:.3f}" if isinstance(value, float) else value
        lines.append(f"| {name} | {shown} |")
    return "\n".join(lines) + "\n"


def inventory_table(
    signs: Sequence[Mapping[str, Any]], posts: Sequence[dict[str, Any]] = ()
) -> str:
    """The signs as a markdown table, with the posts of each support in the row of its lowest sign."""
    on = {row["sign_id"]: ", ".join(filter(None, posts_words(row))) for row in posts}
    numbers = {
        "station m": "station_m",
        "right m": "lateral_m",
        "up m": "up_m",
        "width m": "panel_width_m",
        "height m": "panel_height_m",
        "± along m": "sigma_along_m",
        "to next m": "spacing_m",
    }
    heads = ["sign", "code", "colour", "shape", *numbers, "views", "confidence"]
    heads += ["stands on"] if on else []
    lines = [
        f"# {len(signs)} signs",
        "",
        f"| {' | '.join(heads)} |",
        "|---|---|---|---" + "|--:" * (len(numbers) + 2) + "|---" * bool(on) + "|",
    ]
    for row in signs:
        measured = [_number(row[name]) for name in numbers.values()]
        cells = [row["sign_id"], code_of(row) or "", *_appearance(row), *measured]
        cells += [str(row["views"]), _number(row["confidence"])]
        cells += [on.get(row["sign_id"], "")] if on else []
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _appearance(row: Mapping[str, Any]) -> tuple[str, str]:
    """Colour and shape in words; a back has no colour."""
    color = "back" if row["status"] == "back" else (row["color"] or "?").replace("_", " ")
    return color, row["shape"] or "?"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
