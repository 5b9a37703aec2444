"""What a run leaves in its recording."""

import importlib
import inspect
import json
import pkgutil
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args, get_origin, get_type_hints

import cv2
import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import rerun as rr

import wayside.stages
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.files.writing import PART
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.run import RECORDING, RunRequest, run_log
from wayside.pipeline.view import entities, views
from wayside.pipeline.view.blueprint import GROUND
from wayside.pipeline.view.closing import (
    GATE_NAMES,
    inventory_table,
    opening,
    sign_figures,
    sign_name,
)
from wayside.pipeline.view.drawing import (
    CURVES,
    GREY,
    candidate_entities,
    candidate_words,
    face_in_image,
    landmark_color,
    rejection,
)
from wayside.pipeline.view.observer import Viewing, open_observer
from wayside.pipeline.view.viewer import import_log, viewer_program
from wayside.schemas.detections import COLOR_RGB, VERDICTS, Candidates
from wayside.schemas.frame import Camera, Frame, Pose
from wayside.schemas.landmarks import Landmark, Observation, TrackedFrame
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.roadside import CrossSection
from wayside.schemas.settings import ReadSettings
from wayside.schemas.signs import Sign
from wayside.stages.geometry import iou_matrix
from wayside.stages.georeference import DrivePath
from wayside.stages.georeference.path import PathPoint
from wayside.stages.roadside.sweep import Sweep

from ...made_landmarks import made_landmark, made_motion
from ...stages.made_frames import made_regions
from ..results import sign_row

DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"
FRAMES, SHORT_S = 7, 0.7
START_BYTES = 2_600_000
"""Length of the start of the demo log that holds so many frames."""
TABLES = ("signs.parquet", "observations.parquet", "frames.parquet")
START_S, SHAPES_AND_SIFT = 1.1, "report-shape"
AFTER_THE_DRIVE = {PathPoint, DrivePath, Landmark, Sign, Sweep, CrossSection}
"""Shown all at once, by `closing`."""
CAMERA = "/world/vehicle/camera"
LAYERS = ("image", "keypoints", "matches", "tracks", "signs", "candidates/score", "candidates/sign")
EVERY_FRAME = (
    *(f"{CAMERA}/{layer}" for layer in LAYERS),
    *("/world/vehicle", "/world/path", "/world/rays", "/world/places", "/location/places"),
    *("/world/points/straight", "/world/points/adjusted"),
)
TIMELINES = {"frame", "capture_time", "station_cm", "message_log_time"}


def run(folder, viewing=None, workers=2, until_s=None, preset="default", log=DEMO, **more):
    rr.set_strict_mode(True)
    options = {"run.workers": workers} | more
    options |= {} if until_s is None else {"read.until_s": until_s}
    settings, _ = load_settings(preset, options=options)
    models = load_models(settings)

    def observer(report, part):
        if viewing is not None:
            return open_observer(viewing, part, "demo", models.location_classes, report)
        return None

    return run_log(RunRequest(log, folder, settings, models, open_observer=observer))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    log = folder / "start.mcap"
    log.write_bytes(DEMO.read_bytes()[:START_BYTES])
    return run(folder / "out", Viewing(file=True, detail=True), 1, log=log, **{"roadside.on": True})


def chunks_of(result):
    assert result.view_faults == ()
    return list(rr.chunk.RrdReader(str(result.folder / RECORDING)).stream())


@pytest.fixture(scope="module")
def chunks(recorded):
    return chunks_of(recorded)


@pytest.fixture(scope="module")
def report_run(tmp_path_factory):
    """The chain with shapes and SIFT, up to its first sign."""
    folder, viewing = tmp_path_factory.mktemp("report"), Viewing(file=True, detail=True)
    return run(folder, viewing, 1, START_S, SHAPES_AND_SIFT)


@pytest.fixture(scope="module")
def report_chunks(report_run):
    return chunks_of(report_run)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The start of the drive recorded with no images, and with those of signs."""
    return {
        images: run(tmp_path_factory.mktemp(images), Viewing(file=True, images=images), n, SHORT_S)
        for images, n in (("none", 1), ("signs", 2))
    }


@pytest.fixture(scope="module")
def rows(chunks):
    counted = Counter()
    for chunk in chunks:
        counted[chunk.entity_path] += chunk.num_rows
    return counted


def column(chunks, path, name):
    """All values of one component of an entity, as one flat array of rows."""
    found = []
    for chunk in chunks:
        if chunk.entity_path == path:
            batch = chunk.to_record_batch()
            if name in batch.schema.names:
                found += batch.column(name).to_pylist()
    return [row for row in found if row is not None]


def stream_types():
    """Every type that a stage takes or gives, from the annotations of the stages themselves.

    The check of the calibration is a note of the run.
    """
    found = set()
    for module in pkgutil.walk_packages(wayside.stages.__path__, "wayside.stages."):
        if module.name.startswith("wayside.stages.calibration"):
            continue
        loaded = importlib.import_module(module.name)
        for name, function in inspect.getmembers(loaded, inspect.isgeneratorfunction):
            if function.__module__ != loaded.__name__ or name.startswith("_"):
                continue
            hints = get_type_hints(function)
            first = next(iter(hints.values()), None)
            if get_origin(first) is not Iterator:  # no stage: it does not take a stream
                continue
            for hint in hints.values():
                if get_origin(hint) is Iterator:
                    found |= {t for t in get_args(hint) if t.__module__.startswith("wayside")}
    return found


def test_every_type_that_travels_has_a_view():
    assert len(stream_types()) == 6 + len(AFTER_THE_DRIVE)
    assert stream_types() - set(views.VIEWS) == AFTER_THE_DRIVE


def test_every_path_of_the_viewer_holds_something(chunks, report_chunks):
    filled = filled_paths(chunks) | filled_paths(report_chunks)
    no_paths = {entities.APPLICATION, entities.FRAME, entities.CAPTURE, entities.STATION}
    named = [v for name, v in vars(entities).items() if name.isupper()]
    paths = {path for v in named for path in (v if isinstance(v, tuple) else (v,))}
    paths |= {f"gates/{stage}" for stage in GATE_NAMES if stage != "trajectory"}  # of report-2d
    paths |= {f"{entities.CANDIDATES}/{verdict}" for verdict in ("score", "sign")}
    paths |= {"map/route", "map/signs", "residuals/straight", "residuals/adjusted"}
    paths -= no_paths | {entities.LOG}
    assert len(paths) > 40
    assert {p for p in paths if not any(f"{f}/".startswith(f"/{p}/") for f in filled)} == set()


def filled_paths(chunks):
    """Entities with a component that has a value in some row, except those that clear others or name a series."""
    found = set()
    for chunk in chunks:
        batch = chunk.to_record_batch()
        names = [
            n for n in batch.schema.names if ":" in n and not n.startswith(("Clear", "Series"))
        ]
        if any(pc.max(pc.list_value_length(batch.column(name))).as_py() for name in names):
            found.add(chunk.entity_path)
    return found


def test_outlines_are_shown_with_their_circle_ellipse_and_six_terms(report_chunks):
    strips = {
        name: column(report_chunks, f"{CAMERA}/outlines/{name}", "LineStrips2D:strips")
        for name in ("traced", *CURVES)
    }
    assert [len(frame) for frame in strips["traced"]] == [len(f) for f in strips["circle"]]
    traced, curves = (np.array(strips[name][0]) for name in ("traced", "circle"))
    spread = np.linalg.norm(curves - curves[:, :-1].mean(axis=1, keepdims=True), axis=2)
    np.testing.assert_allclose(spread, spread[:, :1].repeat(spread.shape[1], axis=1), rtol=1e-3)
    errors = [np.linalg.norm(np.array(strips[name][0]) - traced, axis=2).mean() for name in CURVES]
    assert errors[0] > errors[1] > errors[2] > 0


def test_points_matched_by_sift_are_shown_from_image_to_image(report_chunks):
    strips = column(report_chunks, "/world/vehicle/camera/sift_matches", "LineStrips2D:strips")
    ends = np.array([strip for frame in strips for strip in frame])
    assert ends.shape[1:] == (2, 2)
    assert np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)) < 100


def test_the_windowed_adjustment_shows_its_residual_before_and_after(chunks):
    before, after = (
        np.array(column(chunks, f"/window_residuals/{name}", "Scalars:scalars"))[:, 0]
        for name in ("before", "after")
    )
    assert len(before) == len(after) > 0
    assert (after < before).all()


def test_registered_views_look_alike(chunks, recorded):
    first = recorded.inventory.sign_rows[0]["sign_id"]
    words = column(chunks, f"/sign_panels/{first}/outlines", "LineStrips2D:labels")[0]
    assert len(set(words)) > 1
    assert all(float(word.rsplit(" ", 1)[1]) > 0.8 for word in words)


def test_the_straight_motion_that_is_shown_is_straight_though_the_log_has_poses(
    chunks, recorded, report_chunks, report_run
):
    shown, known = (
        np.ravel(column(own, "/residuals/straight", "Scalars:scalars"))
        for own in (chunks, report_chunks)
    )
    tables = [pq.read_table(one.folder / "frames.parquet") for one in (recorded, report_run)]
    prior, straight = (t.column("residual_straight_px").drop_null().to_numpy() for t in tables)
    np.testing.assert_allclose(known, straight, rtol=1e-3)
    assert (shown > prior).all()  # the table of preset default is of the poses


def test_rows_without_confidence_are_marked_by_their_residual_and_not_named(report_chunks):
    (words,) = column(report_chunks, "/world/marks", "Points3D:labels")
    (inks,) = column(report_chunks, "/world/marks", "Points3D:colors")
    assert not column(report_chunks, "/world/names/all", "Points3D:labels")
    residual = [float(one.removesuffix(" px").rsplit(" ", 1)[1]) for one in words]
    place = replace(refused_place(), verdict="sign", score=np.nan)
    red = [landmark_color(replace(place, residual_px=px))[0] for px in (0, 1, 9, np.nan, *residual)]
    assert red[0] < red[1] < red[2] == red[3]
    np.testing.assert_allclose(np.array(inks) >> 24, red[4:], atol=2)  # residuals are rounded


def test_a_type_without_a_view_is_an_error():
    with pytest.raises(TypeError, match="no view for int"):
        views.entities_of(3, "segment", views.ViewState())


def test_every_frame_logs_each_layer_so_that_nothing_stale_is_shown(rows):
    assert {path: rows[path] for path in EVERY_FRAME} == dict.fromkeys(EVERY_FRAME, FRAMES)


def test_images_pass_through_as_they_were_recorded(chunks, recorded):
    blobs = column(chunks, "/world/vehicle/camera/image", "EncodedImage:blob")
    assert len(blobs) == FRAMES
    first = np.array(blobs[0][0], np.uint8).tobytes()
    assert first[:2] == b"\xff\xd8"
    assert first in DEMO.read_bytes()


def test_all_rows_of_a_frame_have_all_timelines(chunks):
    for chunk in chunks:
        if not chunk.is_static and not chunk.entity_path.startswith("/__"):
            assert set(chunk.timeline_names) >= TIMELINES, chunk.entity_path


def test_each_sign_has_its_chain(rows, recorded):
    assert recorded.inventory.signs
    inventory = recorded.inventory
    for row, sign in zip(inventory.sign_rows, inventory.signs, strict=True):
        name, place = row["sign_id"], sign.landmark
        assert rows[f"/world/signs/{name}"] == 1
        assert rows[f"/world/signs/{name}/error"] == 1
        assert rows[f"/world/sign_rays/{name}"] == 1
        assert rows[f"/sign_residuals/{name}"] == len(place.views)
        assert rows[f"/world/vehicle/camera/chains/{name}/measured"] >= len(place.views)


def test_signs_are_named_in_space_all_at_once_and_those_in_view_of_each_frame(chunks, recorded):
    rows = recorded.inventory.sign_rows
    names = [sign_name(row) for row in rows]
    assert names[0].startswith("0001 ")
    (everything,) = column(chunks, "/world/names/all", "Points3D:labels")
    assert sorted(", ".join(everything).split(", ")) == sorted(names)
    assert len(everything) == len({row["assembly_id"] for row in rows})
    frames = column(chunks, "/world/names/in_view", "frame")
    words = column(chunks, "/world/names/in_view", "Points3D:labels")
    shown = dict(zip(frames, (", ".join(one).split(", ") for one in words), strict=True))
    assert sorted(shown) == list(range(FRAMES))
    firsts = {}
    for row in rows:
        first = firsts.get(row["assembly_id"], FRAMES)
        firsts[row["assembly_id"]] = min(first, row["first_frame"])
    for name, row in zip(names, rows, strict=True):
        assert name in shown[row["best_frame"]]
        assert all(name not in shown[frame] for frame in range(firsts[row["assembly_id"]]))


AHEAD = np.array([2.0, -1.0, 20.0])


def refused_place():
    box = (890.0, 490.0, 910.0, 510.0)
    place = {"position": np.array([24.2, -1.6, 40.0]), "right_m": 24.2, "above_m": 1.6}
    size = {"width_m": 5.1, "height_m": 1.9, "color": "blue", "shape": "rectangle"}
    seen = {"views": (Observation(4, 0, 900.0, 500.0, box, 0.3),), "best_frame": 4, "best_box": box}
    about = {"track_id": 7, "station_m": 198.1, "score": 1.5, "residual_px": 0.6}
    return made_landmark(verdict="location", **place | size | seen | about)


def test_the_face_drawn_into_the_best_image_lies_on_the_true_face(recorded):
    camera = next(read_frames(DEMO, ReadSettings(), ReadReport())).camera
    truth = json.loads(DEMO.with_name("demo.truth.json").read_text())
    rows = recorded.inventory.sign_rows
    shares = []
    for row, sign in zip(rows, recorded.inventory.signs, strict=True):
        landmark = sign.landmark
        face = face_in_image(landmark, landmark.best_pose, camera) - 0.5
        seen = [f for s in truth["signs"] for f in s["frames"] if f["frame"] == row["best_frame"]]
        if row["status"] == "sign":
            box = np.concatenate([face.min(axis=0), face.max(axis=0)])[None]
            shares.append(iou_matrix(box, np.array([f["box"] for f in seen])).max())
    assert len(shares) >= 4
    # what has been seen from afar only may be measured half as large again
    assert min(shares) > 0.3
    assert np.median(shares) > 0.8


@pytest.mark.parametrize("facing", [0.0, 30.0])
def test_a_face_in_an_image_has_its_corners_where_a_pinhole_has_them(facing):
    look = {"shape": "diamond", "width_m": 2.0, "height_m": 1.0, "facing_deg": facing}
    place = replace(refused_place(), position=AHEAD, **look)
    camera = Camera(1600, 1200, 1400.0, 1300.0, 799.5, 599.5)
    found = face_in_image(place, Pose(np.eye(3), np.zeros(3)), camera)
    axis = np.array([np.cos(np.radians(facing)), 0.0, -np.sin(np.radians(facing))])
    up = np.array([0.0, -0.5, 0.0])
    corners = AHEAD + np.array([up, axis, -up, -axis, up])
    expected = corners[:, :2] / corners[:, 2:] * (1400.0, 1300.0) + (799.5, 599.5) + 0.5
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert len(face_in_image(place, Pose(np.eye(3), np.array([0.0, 0.0, 21.0])), camera)) == 0


def luminance(rgb):
    """Relative luminance of sRGB, WCAG 2.2."""
    c = np.array(rgb) / 255
    return float(
        np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722)
    )


def contrast(a, b):
    dark, light = sorted((luminance(a), luminance(b)))
    return (light + 0.05) / (dark + 0.05)


def test_everything_stands_out_from_its_ground_by_three_to_one():
    """WCAG 2.2, 1.4.11: spaces have a ground of their own, plots that of the viewer's light or dark theme."""
    for ink in (*COLOR_RGB.values(), GREY, (255, 255, 255), views.BEFORE, views.AFTER):
        assert contrast(ink, GROUND) > 3, ink
    for ink in (views.BEFORE, views.AFTER):
        assert contrast(ink, (255, 255, 255)) > 3
        assert contrast(ink, (20, 20, 20)) > 3


def test_a_refused_place_is_listed_with_its_reason_and_the_numbers_that_decided():
    camera = Camera(1600, 1200, 1400.0, 1400.0, 799.5, 599.5)
    frame = Frame(4, 10, None, "used", "jpeg", b"", camera)
    place = refused_place()
    none, empty = np.zeros(0, np.int32), np.zeros(0, np.float32)
    settled = TrackedFrame(frame, made_motion(0), boxes(0), none, empty, 0, (place,))
    logged = [
        e
        for e in views.entities_of(settled, views.LAST_STAGE, views.ViewState())
        if e.path == "rejections"
    ]
    assert len(logged) == 1
    text = logged[0].parts[0].text.as_arrow_array()[0].as_py()
    assert text.startswith("location: blue rectangle 5.10 x 1.90 m")
    assert "+24.2 m right, +1.6 m above the camera, station 198.1 m" in text
    behind = replace(place, back=True, color=None, verdict="place_score")
    assert rejection(behind).startswith("place_score: back rectangle 5.10 x 1.90 m")


def boxes(count, **columns):
    return replace(Candidates.of(made_regions([[0, 0, 9, 9]] * count)), **columns)


BACK, YELLOW = {"back_score": np.array([2.5])}, {"color": np.array([1], np.int8)}
SURELY = YELLOW | {"color_distance": np.array([0.5])}


@pytest.mark.parametrize(
    ("columns", "more"),
    [({}, ""), (BACK, ", back 2.5"), (YELLOW, ", yellow"), (SURELY, ", yellow 0.5")],
)
def test_a_candidate_says_how_surely_it_is_a_face_a_back_and_a_colour(columns, more):
    words = candidate_words(boxes(1, score=np.array([-4.0]), **columns), 0)
    assert words == f"open, score -4.0{more}"


@pytest.mark.parametrize("verdict", ["sign", "location"])
def test_words_of_candidates_do_not_cover_the_image(verdict):
    some = boxes(3, verdict=np.full(3, VERDICTS.index(verdict), np.uint8))
    (entity,) = candidate_entities(some, set(), detail=False)
    assert len(entity.parts[0].labels.as_arrow_array()) == 3
    assert entity.parts[0].show_labels.as_arrow_array().to_pylist() == [False]


def test_a_row_is_headed_by_what_it_looks_like():
    lengths = ("station_m", "lateral_m", "up_m", "panel_width_m", "panel_height_m")
    lengths += ("sigma_along_m", "spacing_m")
    look = {"color": "red", "shape": "octagon", "views": 4, "confidence": 0.9}
    row = sign_row("d-0001", **dict.fromkeys(lengths, 1.5) | look)
    behind = row | {"status": "back", "color": None}
    heads = [sign_figures(one).split("\n")[0] for one in (row, row | {"color": None}, behind)]
    assert heads == ["# d-0001: red octagon", "# d-0001: ? octagon", "# d-0001: back octagon"]
    assert "| d-0001 |  | back | octagon | 1.50 |" in inventory_table([behind])
    posts = [{"sign_id": "d-0001", "kind": "wood", "number": 1, "width_m": None}]
    assert inventory_table([behind], posts).endswith("| wood, 1 post |\n")


def test_every_class_of_places_is_drawn_where_it_lies():
    places = {"right": (7.0, 0.5), "left": (-9.0, 0.4)}
    classes = tuple(
        GaussianClass(name, np.array(mean), np.eye(2), 1) for name, mean in places.items()
    )
    drawn = {one.path: one.parts[0] for one in opening(GaussianModel("s", classes, "t")).entities}
    for name, (right, above) in places.items():
        (ring,) = drawn[f"location/{name}"].strips.as_arrow_array().to_pylist()
        np.testing.assert_allclose(np.mean(ring[:-1], axis=0), (right, -above), atol=0.1)


def test_viewing_changes_no_table_and_goes_when_it_is_not_asked_for(short, tmp_path):
    out = shutil.copytree(short["signs"].folder, tmp_path / "out")
    seen = [(out / name).read_bytes() for name in TABLES]
    assert (out / RECORDING).exists()
    run(out, workers=1, until_s=SHORT_S)
    assert [(out / name).read_bytes() for name in TABLES] == seen
    assert not (out / RECORDING).exists()


def test_the_recording_verifies(recorded):
    path = recorded.folder / RECORDING
    done = subprocess.run(
        [viewer_program(), "rrd", "verify", path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("images", "fewest", "most"), [("none", 0, 0), ("signs", 1, 4)])
def test_images_are_recorded_as_asked(short, images, fewest, most):
    held = [c for c in chunks_of(short[images]) if c.entity_path == f"{CAMERA}/image"]
    assert fewest <= sum(chunk.num_rows for chunk in held) <= most


def test_blurred_images_are_sharp_on_panels_only(tmp_path):
    recorded = run(tmp_path, Viewing(file=True, blur=True), 2, SHORT_S)
    blobs = column(chunks_of(recorded), "/world/vehicle/camera/image", "EncodedImage:blob")
    boxes = pq.read_table(recorded.folder / "observations.parquet").to_pylist()
    assert blobs
    image = cv2.imdecode(np.array(blobs[-1][0], np.uint8), cv2.IMREAD_GRAYSCALE)
    sharp = cv2.dilate(np.abs(cv2.Laplacian(image, cv2.CV_32F)), np.ones((9, 9))) > 60
    kept = np.zeros(image.shape, bool)
    for x0, y0, x1, y1 in (row["box"] for row in boxes):
        kept[int(y0) - 12 : int(y1) + 12, int(x0) - 12 : int(x1) + 12] = True
    assert 0 < sharp.mean() < 0.1
    assert not (sharp & ~kept).any()


def test_without_images_all_layers_lie_on_those_of_the_imported_log(short, tmp_path):
    import_log(DEMO, "demo", tmp_path / "log.rrd")
    planes, layers = {}, set()
    for path in (short["none"].folder / RECORDING, tmp_path / "log.rrd"):
        reader = rr.chunk.RrdReader(str(path))
        assert [r.recording_id for r in reader.recordings()] == ["demo"]
        for chunk in reader.stream():
            layers.add(chunk.entity_path)
            batch = chunk.to_record_batch()
            if "CoordinateFrame:frame" in batch.schema.names:
                planes[chunk.entity_path] = batch.column("CoordinateFrame:frame")[0].as_py()
    flat = {path for path in layers if path.startswith("/world/vehicle/camera/")}
    assert flat
    assert {planes.get(path, ["none"])[0] for path in flat} == {planes["/camera/image"][0]}


def test_a_frame_not_used_clears_what_was_shown():
    frame = Frame(3, 10, None, "undecodable", "jpeg", b"", None)
    words, cleared = views.entities_of(frame, "read", views.ViewState())
    assert isinstance(words.parts[0], rr.TextLog)
    assert isinstance(cleared.parts[0], rr.Clear)


@pytest.mark.slow
def test_a_killed_run_leaves_a_recording_that_can_be_repaired(tmp_path):
    recording = tmp_path / PART / RECORDING
    command = "from wayside.pipeline.cli import main; main()"
    line = [sys.executable, "-c", command, "run", str(DEMO), "-o", str(tmp_path), "--view", "file"]
    started = subprocess.Popen(line, stdout=subprocess.DEVNULL)
    until = time.monotonic() + 120
    while time.monotonic() < until and started.poll() is None:
        if recording.exists() and recording.stat().st_size > 500_000:
            break
        time.sleep(0.02)
    assert started.poll() is None, "the run ended before it could be killed"
    started.kill()
    started.wait()
    repaired = tmp_path / "repaired.rrd"
    verify = [viewer_program(), "rrd", "verify"]
    assert subprocess.run([*verify, recording], capture_output=True, check=False).returncode == 1
    merge = [viewer_program(), "rrd", "merge", recording, "-o", repaired]
    subprocess.run(merge, capture_output=True, check=True)
    assert subprocess.run([*verify, repaired], capture_output=True, check=False).returncode == 0
    assert any(
        chunk.entity_path == "/world/vehicle/camera/image"
        for chunk in rr.chunk.RrdReader(str(repaired)).stream()
    )
