"""What an image of the detection network's learning says of its faces, and of what is not known of it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from training import detector_images
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.schemas.errors import InputError

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"
DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"


def write_checked(folder, *rows):
    """A table of checked boxes as the one of training is, of a source, an image and its boxes each."""
    path = folder / "checked.parquet"
    schema = pq.read_schema(detector_images.CHECKED_BOXES)
    names = ("x0", "y0", "x1", "y1", "color", "shape")
    held = [
        {"source": source, "image": image}
        | {
            kind: [dict(zip(names, box, strict=False)) for box in boxes.get(kind, ())]
            for kind in ("signs", "other", "unsure")
        }
        for source, image, boxes in rows
    ]
    pq.write_table(pa.Table.from_pylist(held, schema), path)
    return path


def write_set(folder, *scenes):
    folder.mkdir()
    for scene in scenes:
        cv2.imwrite(str(folder / scene["file"]), np.full((60, 80, 3), 128, np.uint8))
    (folder / "scenes.json").write_text(json.dumps(scenes))
    return folder


def scene(file, *, complete=True, **rest):
    sign = {"box": [30, 20, 40, 30], "color": "white", "shape": "circle"}
    return {"file": file, "signs": [sign], "complete": complete} | rest


def test_boxes_of_single_images_bear_their_classes(tmp_path):
    other = {"box": [1, 2, 9, 9], "color": "black", "shape": "rectangle"}
    folder = write_set(tmp_path / "set", scene("mi_1.png"), scene("mi_2.png", signs=[other]))
    first, second = detector_images.scene_set_images(folder, ("mi_",))
    np.testing.assert_array_equal(first.box, [[30, 20, 40, 30]])
    assert first.side.tolist() == [detector_images.FRONT]
    assert first.color.tolist() == [COLORS.index("white")]
    assert first.shape.tolist() == [SHAPES.index("circle")]
    assert second.color.tolist() == [NONE]
    assert first.source == "set/mi"
    assert first.complete[0]
    assert not first.complete[1]


def test_an_image_whose_boxes_were_looked_at_is_complete(tmp_path, monkeypatch):
    checked = write_checked(tmp_path, ("set", "mi_2.png", {}))
    monkeypatch.setattr(detector_images, "CHECKED_BOXES", checked)
    scenes = [scene(f"mi_{number}.png", complete=number == 1) for number in (1, 2, 3)]
    images = detector_images.scene_set_images(write_set(tmp_path / "set", *scenes))
    assert [image.complete[0] for image in images] == [True, True, False]


def test_a_traffic_light_is_no_sign_and_another_distractor_may_be_one(tmp_path):
    things = [{"box": [0, 0, 5, 9], "kind": "traffic light"}, {"box": [50, 0, 60, 9], "kind": "x"}]
    folder = write_set(tmp_path / "set", scene("ro_200.png", distractors=things))
    (image,) = detector_images.scene_set_images(folder)
    np.testing.assert_array_equal(image.ignored, [[50, 0, 60, 9]])
    np.testing.assert_array_equal(image.other, [[0, 0, 5, 9]])


def test_boxes_that_were_looked_at_join_the_labels_of_their_image(tmp_path, monkeypatch):
    boxes = {"signs": [[1, 2, 9, 9, "blue", "circle"], [60, 2, 70, 9, None, None]]}
    boxes |= {"other": [[11, 12, 19, 19]], "unsure": [[50, 50, 59, 59]]}
    rows = ("set", "ro_200.png", boxes), ("another", "ro_201.png", boxes)
    monkeypatch.setattr(detector_images, "CHECKED_BOXES", write_checked(tmp_path, *rows))
    folder = write_set(tmp_path / "set", scene("ro_200.png"), scene("ro_201.png"))
    looked_at, as_labelled = detector_images.scene_set_images(folder)
    np.testing.assert_array_equal(looked_at.box, [[30, 20, 40, 30], [1, 2, 9, 9], [60, 2, 70, 9]])
    assert looked_at.color.tolist() == [COLORS.index("white"), COLORS.index("blue"), NONE]
    assert looked_at.shape.tolist() == [SHAPES.index("circle")] * 2 + [NONE]
    np.testing.assert_array_equal(looked_at.other, boxes["other"])
    np.testing.assert_array_equal(looked_at.ignored, boxes["unsure"])
    assert (len(as_labelled.box), len(as_labelled.other), len(as_labelled.ignored)) == (1, 0, 0)


def test_the_boxes_that_were_looked_at_are_sound():
    sources = set(pq.read_table(detector_images.CHECKED_BOXES)["source"].to_pylist())
    every = [boxes for name in sources for boxes in detector_images.checked_boxes(name).values()]
    signs = [sign for boxes in every for sign in boxes["signs"]]
    assert len(signs) > 900
    assert {sign[4] for sign in signs} <= {*COLORS, None}
    assert {sign[5] for sign in signs} <= {*SHAPES, None}
    for box in (box for boxes in every for kind in boxes.values() for box in kind):
        assert box[0] < box[2]
        assert box[1] < box[3]


def test_distractors_of_a_real_drive_are_no_signs_unless_words_leave_it_open(monkeypatch):
    log = REAL / "ca_city_garmin.mcap"
    if not log.is_file():
        pytest.skip(f"{log} is not at hand")
    monkeypatch.setattr(detector_images, "checked_boxes", lambda name: {})
    first, later, _ = detector_images.real_drive_images(log, 123)
    np.testing.assert_array_equal(first.other, [[0, 697, 862, 719], [901, 283, 1030, 372]])
    plates = [1152, 287, 1170, 309]
    assert plates in later.ignored.tolist()
    assert plates not in later.other.tolist()


def test_pictures_of_doubtful_origin_and_of_other_sources_are_left_out(tmp_path):
    names = ("ro_156.png", "ro_157.png", "mb_001.png")
    folder = write_set(tmp_path / "set", *(scene(name) for name in names))
    assert [image.name for image in detector_images.scene_set_images(folder, ("ro_",))] == [
        "ro_157.png"
    ]


def test_a_missing_picture_is_an_error_that_names_it(tmp_path):
    folder = write_set(tmp_path / "set", scene("mi_1.png"))
    (folder / "mi_1.png").unlink()
    with pytest.raises(InputError, match=r"mi_1\.png"):
        list(detector_images.scene_set_images(folder))


def test_boxes_of_a_rendered_drive_lie_on_the_same_pixels_in_the_band_and_in_the_whole_image():
    band = list(detector_images.rendered_images(DEMO, 8))
    whole = list(detector_images.rendered_images(DEMO, 8, band=False))
    assert len(band) == len(whole) == 3
    assert sum(len(image.box) for image in band) > 10
    for part, full in zip(band, whole, strict=True):
        assert full.camera is not None
        assert part.camera is None
        assert part.rgb.shape[0] < full.rgb.shape[0]
        np.testing.assert_array_equal(part.side, full.side)
        assert set(part.side.tolist()) <= {detector_images.FRONT, detector_images.BACK}
        for one, other in zip(part.box, full.box, strict=True):
            x0, y0, x1, y1 = np.round(one).astype(int)
            shift = round(float(other[1] - one[1]))
            if y0 >= 0 and y1 <= part.rgb.shape[0] and x0 >= 0:
                same = full.rgb[y0 + shift : y1 + shift, x0:x1]
                np.testing.assert_array_equal(part.rgb[y0:y1, x0:x1], same)


def test_a_source_is_left_out_as_a_whole_and_one_of_another_name_is_refused(tmp_path):
    without = detector_images.real_sources(tmp_path, ["ca_city_garmin"])
    assert detector_images.real_sources(tmp_path).keys() - without.keys() == {"ca_city_garmin"}
    with pytest.raises(InputError, match=r"no sources garmin .*scenes_mixed"):
        detector_images.real_sources(tmp_path, ["ca_city_garmin", "garmin"])


def test_nothing_is_learned_from_sources_that_are_for_tests_only(tmp_path):
    sources = detector_images.real_sources(tmp_path)
    assert {"scenes/jd", "scenes/mi", "us_freeway_challenge"} <= sources.keys()
    for source in ("kitti", "autobahn", "mb", "crops"):
        assert source not in " ".join(sources)


def test_drives_and_sets_are_kinds_of_their_own():
    assert detector_images.source_kind("ca_city_garmin") == "ca_city_garmin"
    assert detector_images.source_kind("rendered/learn_alley") == "rendered"
    assert detector_images.source_kind("scenes_mixed/ro") == "scenes_mixed"
