"""A panel is gone only where images of the other survey see past its place."""

import json
from dataclasses import asdict

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer

from wayside.pipeline.fleet.changes import find_changes, parse_survey
from wayside.pipeline.fleet.changes_page import write_page
from wayside.pipeline.fleet.merging import merge_inventory
from wayside.schemas.settings import ReadSettings

from .conftest import FINDS_ALL, drives_of

PLACES = np.array([[70.0, -5.0, 2.2], [104.0, -5.0, 2.2]])  # along the road, to its left, up
COVER = 62.0, (-7.5, -3.0), (0.0, 4.0)
"""What hides the first place: a wall across at 62 m, from its left to its right side, and its height."""


class Surveyed:
    """Two drives a year apart: the first saw two panels, the second none, and its log shows `images`."""

    def __init__(self, simulation, drive, folder):
        self.simulation, self.folder = simulation, folder
        rng = np.random.default_rng(7)
        road = simulation.make_road(0, 130.0, 30.0, rng).select([0, 0])
        road.position[:], road.turn_rad[:], road.forward[:] = PLACES, 0.0, True
        road.size[:], road.identity[:], road.support[:] = 0.75, [0, 1], [0, 1]
        quality = {"fix_sigma_m": 0.1} | FINDS_ALL
        drive(folder, "first", road, rng, quality=quality)
        drive(folder, "second", road.select(slice(0, 0)), rng, year=1, quality=quality)
        self.drive = folder / "drives" / "second"
        merge_inventory(drives_of(folder), folder)

    def write_log(self, images, most=None):
        """The log of the second drive, of what is seen from places along the road; its result names it."""
        log, camera = self.folder / "second.mcap", self.simulation.CAMERA
        lens = {"K": [camera["fx"], 0, camera["cx"], 0, camera["fy"], camera["cy"], 0, 0, 1]}
        lens |= {name: camera[name] for name in ("width", "height")}
        with log.open("wb") as file:
            writer = Writer(file)
            for frame in pq.read_table(self.drive / "frames.parquet").to_pylist()[:most]:
                stamp = Timestamp()
                stamp.FromNanoseconds(frame["header_time_ns"])
                jpeg = cv2.imencode(".jpg", images(frame["x"]))[1].tobytes()
                about, time = {"timestamp": stamp, "frame_id": "camera"}, frame["log_time_ns"]
                given = CameraCalibration(distortion_model="plumb_bob", **lens, **about)
                picture = CompressedImage(data=jpeg, format="jpeg", **about)
                writer.write_message("/calibration", given, time, time)
                writer.write_message("/image", picture, time, time)
            writer.finish()
        run = json.loads((self.drive / "run.json").read_text())
        read = asdict(ReadSettings(spacing_m=self.simulation.SPACING_M))
        run |= {"log_path": str(log), "settings": {"read": read}}
        (self.drive / "run.json").write_text(json.dumps(run))
        return log

    def changes(self):
        """What became of both panels, in the order of the road."""
        report = find_changes(self.folder, parse_survey("2024"), parse_survey("2025"))
        rows = pq.read_table(self.folder / "changes.parquet").to_pylist()
        return report, sorted(rows, key=lambda row: row["lon_deg"])


@pytest.fixture
def surveyed(simulation, drive, tmp_path):
    """Two drives of two years."""
    return Surveyed(simulation, drive, tmp_path)


def texture(seed, width, height):
    """Blobs of several sizes."""
    rng = np.random.default_rng(seed)
    grids = [rng.uniform(0, 255, (height // n, width // n)) for n in (2, 5, 12)]
    layers = [cv2.resize(one.astype(np.float32), (width, height)) for one in grids]
    return np.asarray(np.mean(layers, axis=0), np.uint8)


def view(along, *, covered):
    """A wall across the road at 250 m and, where `covered`, another one in front of the first place."""
    image = np.full((1200, 1600), 128, np.uint8)
    walls = [(250.0, (-150.0, 150.0), (-60.0, 120.0), texture(1, 600, 360))]
    if covered and along < COVER[0] - 2:
        walls.append((*COVER, texture(2, 180, 160)))
    for at, (right, left), (low, high), surface in walls:
        scale = 1400.0 / (at - along)
        corners = [
            (799.5 - scale * (y + 1.8), 599.5 - scale * (z - 2.0))
            for y, z in ((left, high), (right, high), (left, low))
        ]
        height, width = surface.shape
        source = np.array([(0, 0), (width - 1, 0), (0, height - 1)], np.float32)
        turn = cv2.getAffineTransform(source, np.array(corners, np.float32))
        cv2.warpAffine(surface, turn, (1600, 1200), dst=image, borderMode=cv2.BORDER_TRANSPARENT)
    return image


def test_a_place_that_something_nearer_hides_was_not_looked_at(surveyed):
    surveyed.write_log(lambda along: view(along, covered=True))
    report, rows = surveyed.changes()
    assert not report.unseen
    told = [(row["change"], row["hidden_after"], row["drives_after"]) for row in rows]
    assert told == [("not_looked_at", 1, 0), ("gone", 0, 1)]
    assert (rows[0]["drive_after"], rows[0]["probability"]) == ("second", None)
    write_page(surveyed.folder, surveyed.folder / "page.html", ("2024", "2025"))
    text = (surveyed.folder / "page.html").read_text()
    assert "not looked at; hidden from 1 drive, second frame" in text


@pytest.mark.parametrize(
    "image", [lambda along: view(along, covered=False), lambda _: np.full((1200, 1600), 200, "u1")]
)
def test_a_place_that_images_see_past_or_tell_nothing_of_is_gone(surveyed, image):
    surveyed.write_log(image)
    report, rows = surveyed.changes()
    assert not report.unseen
    assert [(row["change"], row["hidden_after"]) for row in rows] == [("gone", 0)] * 2


def test_without_its_log_what_hid_a_place_from_a_drive_is_said_to_be_unknown(surveyed):
    surveyed.write_log(lambda along: view(along, covered=True)).unlink()
    report, rows = surveyed.changes()
    assert [(row["change"], row["hidden_after"]) for row in rows] == [("gone", 0)] * 2
    assert report.unseen[0].startswith("second: images are taken from the log")
    assert "what hid a place from them is unknown" in str(report)


def test_a_log_that_is_shorter_than_at_its_run_is_said_to_be(surveyed):
    surveyed.write_log(lambda along: view(along, covered=True), most=8)
    report, rows = surveyed.changes()
    assert [row["hidden_after"] for row in rows] == [1, 0]  # the log shows the first place still
    assert "shorter than it was at the run" in report.unseen[0]
