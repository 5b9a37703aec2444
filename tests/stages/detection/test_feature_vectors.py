import numpy as np

from wayside.schemas.detections import SOURCES, Regions
from wayside.schemas.frame import Camera
from wayside.stages.detection.feature_vectors import REGION_FEATURES, region_features

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)


def test_boxes_of_networks_and_predicted_ones_are_classified_as_the_regions_learned_from():
    n = len(SOURCES)
    box = np.tile(np.array([[10, 10, 30, 30]], np.float32), (n, 1))
    regions = Regions(
        box, np.full(n, 300, np.int32), np.zeros((n, 3), np.float32), np.arange(n, dtype=np.uint8)
    )
    shown = region_features(regions, CAMERA)[:, REGION_FEATURES.index("source")]
    named = dict(zip(SOURCES, shown.astype(int).tolist(), strict=True))
    level = SOURCES.index("level")
    assert {named[name] for name in ("level", "network", "external", "predicted")} == {level}
    assert [named[name] for name in ("pass1", "pass2", "moved")] == [0, 1, SOURCES.index("moved")]
