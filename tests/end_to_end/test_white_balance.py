"""A camera that is out of balance sees the same signs in the same colours."""

from pathlib import Path

import numpy as np
import pytest

import wayside
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.flow import Flow
from wayside.pipeline.workers import StageClock
from wayside.stages.imaging.pixels import road_chromaticity

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
UNTIL_S = 2.0
CAST = np.array([0.72, 1.0, 1.25])
"""Of blue, green, red."""


def signs_of(log):
    """Colour and shape of the signs at the start of a drive, in order."""
    found = wayside.run(log, settings={"read.until_s": UNTIL_S})
    rows = found.signs.filter(np.array(found.signs["status"]) == "sign")
    return list(zip(rows["color"].to_pylist(), rows["shape"].to_pylist(), strict=True))


@pytest.fixture(scope="module")
def warm(altered_demo, tmp_path_factory):
    """The demo drive through a camera with a warm cast."""
    path = tmp_path_factory.mktemp("cast") / "warm.mcap"
    return altered_demo(path, lambda image: np.clip(np.rint(image * CAST), 0, 255).astype(np.uint8))


def test_a_cast_of_the_camera_changes_no_colour(warm):
    recorded = signs_of(DEMO)
    assert len({color for color, _ in recorded}) >= 3
    assert signs_of(warm) == recorded


def cast_seen(log, preset):
    """What colour the road has in the first image that a preset looks at."""
    settings, _ = load_settings(preset)
    frames = read_frames(log, settings.read, ReadReport())
    item = next(iter(Flow(settings, load_models(settings), StageClock()).detect(frames)))
    assert item.image.rgb is not None
    assert item.frame.camera is not None
    colour = road_chromaticity(item.image.rgb, item.frame.camera)
    return float(np.linalg.norm(colour))


def test_preset_default_sees_the_road_nearly_grey(warm):
    assert cast_seen(warm, "default") < 0.16


def test_preset_report_sees_the_road_as_it_was_recorded(warm):
    assert cast_seen(warm, "report") > 0.35
