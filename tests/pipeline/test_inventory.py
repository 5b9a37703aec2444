"""The tables of a result, from finished frames made by hand."""

import dataclasses

import numpy as np
import pyarrow.parquet as pq
import pytest

from wayside.pipeline.results.inventory import InventoryWriter
from wayside.schemas.detections import Candidates, Dropped, verdict_code
from wayside.schemas.errors import OutputError
from wayside.schemas.frame import Camera, Fix, Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.settings import MotionSettings
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS
from wayside.stages.georeference import DriveRecord, collect, georeference, place_signs

from ..made_landmarks import made_landmark, made_motion
from ..stages.made_frames import made_regions

CAMERA = Camera(1600, 1200, 1400, 1400, 800, 600)


def candidates(*verdicts):
    regions = made_regions([[10, 20, 30, 60]] * len(verdicts), (100, 100, 100), 700)
    codes = np.array([verdict_code(v) for v in verdicts], np.uint8)
    return dataclasses.replace(Candidates.of(regions), verdict=codes)


def place(track, frame, station, lateral, **changes):
    made = made_landmark(track_id=track, right_m=lateral, station_m=station, above_m=1.0)
    (view,) = made.views
    views = tuple(dataclasses.replace(view, frame=n) for n in (frame, frame - 1))
    seen = {"views": views, "best_frame": frame, "best_time_ns": frame * 10**9}
    seen |= {"best_pose": made_motion(frame).pose}
    unknown = dict.fromkeys(("facing_deg", "sigma_facing_deg", "shape_distance"), np.nan)
    return dataclasses.replace(made, **seen | unknown | changes)


def settled(index, *places, verdicts=(), tracks=(), used=True, fix=None):
    status = "used" if used else "thinned"
    frame = Frame(index, 10**9 * index + 5, None, status, "jpeg", b"", CAMERA, fix=fix)
    score = np.full(len(verdicts), np.nan, np.float32)
    found, tracks = candidates(*verdicts), np.array(tracks, np.int32)
    return TrackedFrame(
        frame, made_motion(index) if used else None, found, tracks, score, 7, places
    )


def write(folder, frames, **options):
    """The inventory, and the rows of its signs, observations and images."""
    writer, record = InventoryWriter(folder, "drive", **options), DriveRecord()
    for frame in collect(iter(frames), record):
        writer.append(frame)
    (path,) = georeference(iter(record.points), MotionSettings())
    inventory = writer.finish(path, tuple(place_signs(iter(record.landmarks), path, 0.5)))
    tables = (pq.read_table(folder / table.file) for table in (SIGNS, OBSERVATIONS, FRAMES))
    return inventory, *(table.to_pylist() for table in tables)


def drive():
    other = place(5, 3, 31.0, -4.0, verdict="location")
    return [
        settled(0, verdicts=("color", "sign"), tracks=(-1, 4)),
        settled(1, used=False),
        settled(2, place(9, 2, 31.0, 4.0), verdicts=("few_views",), tracks=(9,)),
        settled(3, place(4, 3, 30.0, 4.0), other, verdicts=("sign",), tracks=(4,)),
    ]


def test_signs_are_numbered_by_station_and_observations_name_their_sign(tmp_path):
    _, signs, observations, _ = write(tmp_path, drive())
    numbered = [(r["sign_id"], r["station_m"]) for r in signs]
    assert numbered == [("drive-0001", 30.0), ("drive-0002", 31.0)]
    assert [signs[0][n] for n in ("up_m", "bottom_m", "views")] == pytest.approx([2.8, 2.4, 2])
    unknown = ("facing_deg", "shape_distance", "lon_deg", "sigma_east_m")
    assert [signs[0][name] for name in unknown] == [None] * 4
    seen = [(r["frame"], r["sign_id"], r["verdict"]) for r in observations]
    first, last = ((frame, "drive-0001", "sign") for frame in (0, 3))
    assert seen == [first, (2, "drive-0002", "few_views"), last]
    for table in (SIGNS, OBSERVATIONS, FRAMES):
        assert pq.read_schema(tmp_path / table.file).equals(table.schema, check_metadata=True)
    (tmp_path / "every").mkdir()
    assert len(write(tmp_path / "every", drive(), every_region=True)[2]) == 4


def test_every_image_has_a_row_with_its_regions_counted_by_reason_and_in_all(tmp_path):
    room = zip(drive(), (5, 0, 6, 7), strict=True)
    frames = [dataclasses.replace(frame, dropped=Dropped(10, count)) for frame, count in room]
    inventory, _, _, rows = write(tmp_path, frames)
    assert [r["status"] for r in rows] == ["used", "thinned", "used", "used"]
    assert [rows[1][name] for name in ("x", "candidates")] == [None] * 2
    assert rows[0]["baseline_m"] is None
    assert rows[2]["ties"] == 0
    assert rows[3]["x"] == pytest.approx(24.0)
    counted = [(r["left_out"], r["outside_size"]) for r in rows]
    assert counted == [(5, 10), (None, None), (6, 10), (7, 10)]
    assert (inventory.verdicts["left_out"], inventory.verdicts["size"]) == (18, 40)


def test_fixes_add_wgs84_and_geoparquet_metadata(tmp_path):
    fixes = [Fix(38.0, -98.0 + 1e-4 * n, 500.0, None) for n in range(4)]
    frames = [
        dataclasses.replace(f, frame=dataclasses.replace(f.frame, fix=x))
        for f, x in zip(drive(), fixes, strict=True)
    ]
    _, (row, _), _, _ = write(tmp_path, frames)
    assert b"geo" in pq.read_metadata(tmp_path / SIGNS.file).metadata
    assert row["lat_deg"] == pytest.approx(38.0, abs=1e-3)
    assert len(row["geometry"]) == 29
    for name in ("sigma_east_m", "sigma_north_m", "sigma_alt_m"):
        assert 0.8 < row[name] < 4.0  # fixes of unknown error


def test_signs_grow_with_the_lengths_that_the_whole_drive_gives(tmp_path):
    steps, fixed_m = 30, 8.2  # the images were first taken for 8 m apart
    frames = []
    for n in range(steps):
        east = n * fixed_m / 6_378_137.0 / np.cos(np.radians(38.0))
        fix = Fix(38.0, -98.0 + np.degrees(east), 500.0, (0.02, 0.02, 0.03))
        frame = settled(n, *([place(4, n, 8.0 * n + 12, 4.0)] if n == 20 else []), fix=fix)
        ratio, source = (1.0, 0.001) if n > 1 else (np.nan,) * 2, "fixes" if n else "start"
        motion = dataclasses.replace(frame.motion, source=source, length_ratio=ratio)
        frames.append(dataclasses.replace(frame, motion=motion))
    found, (row,), _, images = write(tmp_path, frames)
    scale = fixed_m / 8.0
    scaled = {"ahead_m": 12, "panel_width_m": 0.6, "lateral_m": 4.0, "up_m": 1.0 + 1.8}
    assert {n: row[n] for n in scaled} == pytest.approx(
        {n: length * scale for n, length in scaled.items()}, rel=2e-3
    )
    assert row["station_m"] == pytest.approx((160 + 12) * scale, rel=3e-3)
    assert images[29]["station_m"] == pytest.approx(29 * fixed_m, abs=0.5)
    assert images[10]["baseline_m"] == pytest.approx(fixed_m, abs=0.02)
    assert found.path.camera_height_m == pytest.approx(1.8 * scale, rel=2e-3)


@pytest.mark.parametrize(
    ("changes", "status", "confidence"),
    [
        ({"score": -1.0}, "uncertain", None),
        ({"back": True, "color": None, "score": -0.2}, "back", 0.45),
    ],
)
def test_a_sign_of_little_confidence_is_uncertain_and_a_back_is_a_back_however_sure(
    tmp_path, changes, status, confidence
):
    seen = place(4, 1, 30.0, -6.0, **changes)
    _, (row,), _, _ = write(tmp_path, [settled(0), settled(1, seen)])
    assert row["status"] == status
    if confidence:
        assert row["color"] is None
        assert row["confidence"] == pytest.approx(confidence, abs=0.01)


def test_a_drive_without_signs_gives_empty_tables(tmp_path):
    assert write(tmp_path, [settled(0)])[1:3] == ([], [])


def test_a_missing_folder_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="Choose another folder"):
        InventoryWriter(tmp_path / "missing", "drive")


def test_nothing_is_left_behind_when_a_run_is_given_up(tmp_path):
    writer = InventoryWriter(tmp_path, "drive")
    writer.append(drive()[0])
    writer.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_duplicate_is_at_no_distance_and_imported_images_keep_their_names(tmp_path):
    start, copy, end = settled(0), settled(1, used=False), settled(2)
    named = dataclasses.replace(start.frame, name="US36_0001.jpg", date="2009-05-14 10:31:07")
    start = dataclasses.replace(start, frame=named)
    twice = dataclasses.replace(copy.frame, status="duplicate", name="US36_0002.jpg")
    *_, rows = write(tmp_path, [start, dataclasses.replace(copy, frame=twice), end])
    assert [r["baseline_m"] for r in rows] == [None, 0.0, 8.0]
    assert [r["station_m"] for r in rows] == [0.0, None, 16.0]
    assert [r["image_name"] for r in rows] == ["US36_0001.jpg", "US36_0002.jpg", None]
    assert [r["image_date"] for r in rows] == ["2009-05-14 10:31:07", None, None]
