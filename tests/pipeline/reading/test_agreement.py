"""The demo drive with its poses in other conventions, scales and places: used right, or left out and said."""

import re
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer
from scipy.spatial.transform import Rotation

from wayside.schemas.errors import InputError
from wayside.stages.odometry import AXES

from .conftest import read

DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"
DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def write(path, pose=None, without=(), late_ns=lambda topic, time: 0):
    """The demo drive with each pose (rotation, centre) changed, and late by topic and log time on both clocks."""
    with DEMO.open("rb") as source, path.open("wb") as stream, Writer(stream) as writer:
        reader = make_reader(source, decoder_factories=[DecoderFactory()])
        for _, channel, record, message in reader.iter_decoded_messages():
            if channel.topic in without:
                continue
            if channel.topic == "/pose" and pose is not None:
                q, p = message.pose.orientation, message.pose.position
                rotation, centre = pose(
                    Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), np.array([p.x, p.y, p.z])
                )
                q.x, q.y, q.z, q.w = Rotation.from_matrix(rotation).as_quat().tolist()
                p.x, p.y, p.z = centre.tolist()
            late = late_ns(channel.topic, record.log_time)
            message.timestamp.FromNanoseconds(message.timestamp.ToNanoseconds() + late)
            writer.write_message(channel.topic, message, record.log_time + late, 0)
    return path


@pytest.fixture(scope="module")
def sound():
    return read(DEMO)[0]


CONVENTIONS = {
    **{
        axes: (lambda r, c, m=mount: (r @ m.T, c), f"of a vehicle ({axes})")
        for axes, mount in AXES.items()
    },
    "north, east, down": (
        lambda r, c: (DOWN @ r @ AXES["x forward, y right, z down"].T, DOWN @ c),
        "of a vehicle (x forward, y right, z down)",
    ),
    "camera in a world with z down": (lambda r, c: (DOWN @ r, DOWN @ c), "has z down"),
    "inverted": (lambda r, c: (r.T, -r.T @ c), "the world in the camera"),
}


@pytest.mark.parametrize("convention", sorted(CONVENTIONS))
def test_poses_of_one_known_convention_are_used_so_and_it_is_noted(tmp_path, sound, convention):
    change, words = CONVENTIONS[convention]
    frames, report = read(write(tmp_path / "drive.mcap", change))
    for frame, other in zip(frames, sound, strict=True):
        assert frame.pose.pose.centre == pytest.approx(other.pose.pose.centre, abs=1e-6)
        assert frame.pose.pose.rotation == pytest.approx(other.pose.pose.rotation, abs=1e-6)
    assert len(report.notes) == 1
    assert words in report.notes[0]


def test_the_world_of_the_first_camera_is_turned_upright(tmp_path, sound):
    first = sound[0].pose.pose

    def relative(r, c):
        return first.rotation.T @ r, first.rotation.T @ (c - first.centre)

    frames, report = read(write(tmp_path / "drive.mcap", relative))
    assert "has y down, as a camera has" in report.notes[0]
    rise = [f.pose.pose.centre[2] for f in frames]
    assert np.ptp(rise) == pytest.approx(
        np.ptp([f.pose.pose.centre[2] for f in sound]), abs=2.0
    )  # the camera looks 0.4 deg up


CONTRADICTIONS = {
    "mirrored": lambda r, c: (r, c * [1.0, -1.0, 1.0]),
    "standing": lambda r, c: (r, 0 * c),
    "sideways": lambda r, c: (r @ Rotation.from_euler("x", 60, degrees=True).as_matrix(), c),
}


@pytest.mark.parametrize("contradiction", sorted(CONTRADICTIONS))
def test_poses_that_the_images_contradict_are_left_out_with_the_figures(tmp_path, contradiction):
    change = CONTRADICTIONS[contradiction]
    frames, report = read(write(tmp_path / "drive.mcap", change))
    assert all(f.used and f.pose is None and f.fix is not None for f in frames)
    assert "the poses of /pose are left out: they contradict the images: 1" in report.notes[0]
    alone = write(tmp_path / "alone.mcap", change, without=("/gps",))
    with pytest.raises(InputError, match=r"contradict the images.*--spacing"):
        read(alone)
    frames, _ = read(alone, spacing_m=8.05)
    assert all(f.used and f.pose is None for f in frames)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"late_ns": lambda topic, _: 3 * 10**9 * (topic == "/pose")}, "they turn .* but .* later"),
        ({"late_ns": lambda topic, _: -25 * 10**8 * (topic == "/pose")}, "they turn .* earlier"),
        ({"pose": lambda r, c: (r, 3.2808 * c)}, "their lengths are 3.2"),
    ],
    ids=["late on all clocks", "early on all clocks", "in feet"],
)
def test_poses_off_in_time_or_scale_are_left_out_where_fixes_go_on(tmp_path, change, words):
    frames, report = read(write(tmp_path / "drive.mcap", **change))
    assert all(f.pose is None and f.fix is not None for f in frames)
    assert re.search(words, report.notes[0])


def test_poses_that_stop_while_the_camera_goes_on_do_not_hide_its_motion(tmp_path):
    seen = []

    def stuck(r, c):
        seen.append((r, c))
        return seen[min(len(seen) - 1, 11)]

    frames, report = read(write(tmp_path / "drive.mcap", stuck))
    assert sum(f.used for f in frames) >= 18
    assert any("left out" in note for note in report.notes)


@pytest.mark.parametrize("since", [4, 12])
def test_a_log_whose_clock_was_set_back_is_refused(tmp_path, sound, since):
    def back(topic, time):
        return -3600 * 10**9 * (time >= sound[since].log_time_ns)

    path = write(tmp_path / "drive.mcap", late_ns=back)
    with pytest.raises(
        InputError, match=f"clock was set back .* Image {since} .*60 minutes earlier"
    ):
        read(path)
