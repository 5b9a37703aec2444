"""`wayside fit` on a folder of pictures with labels, and a run that takes the models."""

import json
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.fitting.report import format_fit
from wayside.pipeline.fitting.samples import labelled_drives, region_samples
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.labels.wayside_labels import write_labels
from wayside.pipeline.models.model_files import load_models
from wayside.schemas.errors import InputError, OutputError, UsageError
from wayside.schemas.labels import SIGN, Label, LabelledImage, Labels
from wayside.schemas.settings import ReadSettings

from ..results import invoke

WIDTH, HEIGHT, SIDE = 240, 120, 30
BLUE = (20, 50, 150)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Twelve pictures of a grey road, each with a blue square of its own, all labelled; and their labels."""
    folder = tmp_path_factory.mktemp("pictures")
    random = np.random.default_rng(0)
    labels, complete = [], []
    for k in range(12):
        tiles = random.uniform(60, 200, (8, 16, 1)) * np.array([1.0, 1.02, 0.97])
        image = cv2.resize(
            tiles.astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST
        )
        image += random.normal(0, 3, image.shape)
        x, y = random.integers(10, WIDTH - SIDE - 10), random.integers(10, HEIGHT - SIDE - 10)
        image[y : y + SIDE, x : x + SIDE] = np.array(BLUE) + random.normal(0, 3, 3)
        pixels = cv2.cvtColor(np.clip(image, 0, 255).astype(np.uint8), cv2.COLOR_RGB2BGR)
        name = f"road_{k}.png"
        cv2.imwrite(str(folder / name), pixels)
        where = LabelledImage(image_name=name)
        box = (float(x), float(y), float(x + SIDE), float(y + SIDE))
        labels.append(Label(where, SIGN, box, "blue", "rectangle", panel=f"sign {k}"))
        complete.append(where)
    file = folder.parent / f"{folder.name}.parquet"
    write_labels(Labels(tuple(labels), tuple(complete)), file)
    return folder, file


fit = partial(invoke, "fit")


@pytest.mark.parametrize(("margin_px", "met"), [(0, 12), (3, 0)])
def test_regions_that_cover_a_part_of_a_face_have_its_colour_but_not_its_shape(
    pictures, margin_px, met
):
    known = read_labels(pictures[1])
    grown = [np.add(one.box, np.array([-1, -1, 1, 1]) * margin_px) for one in known.labels]
    rows = zip(known.labels, grown, strict=True)
    labels = replace(known, labels=tuple(replace(one, box=tuple(box)) for one, box in rows))
    settings, _ = load_settings("report-shape")
    drives = labelled_drives([labels], [pictures[0]], settings.read, complete=False)
    assert region_samples(drives, settings).met == 12
    assert region_samples(drives, settings, load_models(settings).color_classes).met == met


def test_pictures_and_labels_become_models_that_a_run_takes(pictures, tmp_path):
    folder, labels = pictures
    out = tmp_path / "models"
    words = ["--source", "this test", "--licence", "CC0-1.0", "--model", "color"]
    words += ["--space", "rgb", "-o", out]
    said = fit(labels, "--images", folder, *words)
    assert "12 labelled images, 12 boxes of 12 signs" in said
    assert "color.json written" in said
    assert f"wayside run drive.mcap --preset report --models {out}" in said
    settings, _ = load_settings("report-shape", None, [], {"models.folder": str(out)})
    models = load_models(settings)
    blue = next(one for one in models.color_classes.classes if one.name == "blue")
    shipped = load_models(load_settings("report-shape")[0])
    assert blue.count == 12  # a region of the first pass: the second has none in even colour
    assert blue.mean == pytest.approx(BLUE, abs=4)
    assert models.color_classes.provenance != shipped.color_classes.provenance
    assert models.shape_classes.provenance == shipped.shape_classes.provenance
    for stated in ("this test", "CC0-1.0", "SHA-256", "12 labelled images", "12 signs"):
        assert stated in models.color_classes.provenance


def test_samples_that_a_run_has_chosen_are_told(pictures, tmp_path):
    folder, labels = pictures
    whole = read_labels(labels)
    for labelled, told in ((whole, False), (Labels(whole.labels, ()), True)):
        drives = labelled_drives([labelled], [folder], ReadSettings(), complete=False)
        assert ("no image is complete" in format_fit([], drives, tmp_path)) == told


def test_figures_and_curves_of_foreign_labels_stand_beside_the_models(pictures, tmp_path):
    known = read_labels(pictures[1]).labels
    images = [
        {"id": k, "file_name": f"road_{k}.png", "width": WIDTH, "height": HEIGHT} for k in range(12)
    ]
    found = [
        {"image_id": k, "category_id": 1, "bbox": [x0, y0, x1 - x0, y1 - y0], "id": k}
        for k, (x0, y0, x1, y1) in enumerate(one.box for one in known)
    ]
    coco = {"images": images, "annotations": found, "categories": [{"id": 1, "name": "info"}]}
    labels, classes = tmp_path / "coco.json", tmp_path / "classes.toml"
    labels.write_text(json.dumps(coco))
    classes.write_text('[classes]\ninfo = { color = "blue", shape = "rectangle" }\n')
    where = ["--classes", classes, "--images", pictures[0], "-o", tmp_path]
    assert "color.json written" in fit(labels, *where, "--model", "color", "--space", "lab")
    figures = json.loads((tmp_path / "fit.json").read_text())
    color = figures["models"]["color"]
    assert figures["held_out"] == "stretches of road"
    assert color["space"] == "lab"
    assert color["labelled_faces"] == color["faces_with_a_region"] == 12
    blue = color["held_out"]["classes"]["blue"]
    assert blue["signs"] == 12
    assert blue["named"][0] > 0.9
    assert color["held_out"]["false_rate"][0] < color["shipped_on_the_same"]["false_rate"]
    page = (tmp_path / "fit.html").read_text()
    assert "<svg" in page
    assert "area 1.00" in page or "area 0.9" in page
    assert "http" not in page


def test_landmarks_need_a_log(pictures, tmp_path):
    folder, labels = pictures
    words = "location: not written, folders of images have no landmarks"
    with pytest.raises(InputError, match=words):
        fit(labels, "--images", folder, "--model", "location", "-o", tmp_path)
    assert not list(tmp_path.iterdir())


def test_labels_that_are_too_few_are_told_before_any_image_is_read(pictures, tmp_path):
    known, folder = read_labels(pictures[1]), tmp_path / "broken"
    folder.mkdir()
    for k in range(12):
        (folder / f"road_{k}.png").write_text("no image")
    write_labels(Labels(known.labels[:3], known.complete), tmp_path / "few.parquet")
    with pytest.raises(InputError) as refused:
        fit(tmp_path / "few.parquet", "--images", folder, "-o", tmp_path / "models")
    words = str(refused.value)
    assert "5 labelled signs of a colour are needed" in words
    assert "there are 3 blue" in words
    assert "confidence: not written, 10 labelled signs of a landmark are needed" in words


def test_models_of_before_are_not_overwritten_unasked(pictures, tmp_path):
    folder, labels = pictures
    (tmp_path / "color.json").write_text("mine")
    with pytest.raises(OutputError, match="--overwrite"):
        fit(labels, "--images", folder, "--model", "color", "-o", tmp_path)
    assert (tmp_path / "color.json").read_text() == "mine"


def test_labels_of_other_images_and_a_file_of_labels_too_many_are_refused(pictures, tmp_path):
    folder, _ = pictures
    there = LabelledImage(image_name="elsewhere.png")
    file = tmp_path / "labels.parquet"
    write_labels(Labels((Label(there, SIGN, (0, 0, 9, 9), "blue"),)), file)
    with pytest.raises(InputError, match="no_such_image"):
        fit(file, "--images", folder, "-o", tmp_path / "out")
    with pytest.raises(UsageError, match="one for each"):
        fit(file, file, "--images", folder, "-o", tmp_path / "out")


def test_stretches_are_contiguous_and_a_sign_is_in_one_alone(pictures):
    folder, labels = pictures
    (drive,) = labelled_drives([read_labels(labels)], [folder], ReadSettings(), complete=False)
    assert list(drive.stretch) == list(range(12))
    assert sorted(drive.stretch.values()) == list(drive.stretch.values())
    assert len(set(drive.stretch.values())) == 6  # two images each, at least
    assert drive.fold is None
    frames = np.array([0, 11, 40])
    assert drive.stretch_of(frames, np.full(3, -1)).tolist() == [0, 5, 5]
    assert drive.stretch_of(frames, np.full(3, 11)).tolist() == [5, 5, 5]


def test_several_drives_are_held_out_whole(pictures):
    folder, labels = pictures
    drives = labelled_drives(
        [read_labels(labels)] * 2, [folder, folder], ReadSettings(), complete=False
    )
    assert [one.fold for one in drives] == [0, 1]
    assert not set(drives[0].stretch.values()) & set(drives[1].stretch.values())
    assert not set(drives[0].faces.sign.tolist()) & set(drives[1].faces.sign.tolist())
