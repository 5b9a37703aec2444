"""The page of candidates to mark, and the labels that its marks become."""

import json
import math
import re

import numpy as np
import pyarrow.parquet as pq
import pytest

from wayside.pipeline.labelling.page import COLOR_KEYS, KINDS, SHAPE_KEYS, margins, questions
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.labels.wayside_labels import read_label_file
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import OutputError
from wayside.schemas.tables import FRAMES, OBSERVATIONS

from .results import frame_rows, invoke, make_log, observation_row, sign_row, table_of, write_tables

STEM = "d <b>&1"
NAME = f"{STEM}-0001"


def box_at(x, y=40, side=12):
    return [float(x), float(y), float(x + side), float(y + side)]


def observation(frame, number, box, verdict, score, track=None, sign=None, source="level"):
    about = {"track_id": track, "sign_id": sign, "verdict": verdict, "score": score}
    look = {"box": box, "source": source, "color": "red", "shape": "octagon"}
    return observation_row(frame, number, **about | look)


ROWS = [
    observation(0, 0, box_at(10), "sign", 6.0, 3, NAME),
    observation(1, 1, box_at(14, side=16), "sign", 5.0, 3, NAME),
    observation(1, 2, box_at(14, side=18), "overlap", 4.0, 3, NAME),
    observation(0, 3, box_at(60), "place_score", 3.5, 4),
    observation(0, 4, box_at(100), "unmatched", 2.0),
    observation(0, 5, box_at(11), "score", 1.9),  # on the sign: not asked about again
    observation(1, 6, box_at(90), "score", 1.0),
    observation(1, 7, box_at(91), "score", 0.9),  # the same thing as 6
    observation(1, 8, box_at(120), "score", -5.0),
    observation(1, 9, box_at(60), "open", -9.0, source="predicted"),
]


def result(folder):
    """A result with one sign in a log of two images."""
    images = [np.full((120, 160, 3), (90, green, 90), np.uint8) for green in (120, 121)]
    log = make_log(folder / f"{STEM}.mcap", images)
    seen = {"best_frame": 1, "best_box": box_at(14), "first_frame": 0, "views": 2}
    look = {"color": "yellow", "shape": "diamond", "confidence": 0.6}
    about = {"log": log.name, "log_path": str(log), "log_fingerprint": "12"}
    about["settings"] = {"read": {}}
    signs = [sign_row(NAME, log=STEM, **seen | look)]
    return write_tables(folder / "out", signs, ROWS, frame_rows(log), **about)


@pytest.fixture(scope="module")
def marked(tmp_path_factory):
    """A result and the page of it."""
    folder = tmp_path_factory.mktemp("label")
    out = result(folder)
    assert "6 to mark" in invoke("label", out, "-o", folder / "page")
    return out, folder / "page" / "index.html"


def page_data(page):
    return json.loads(re.search(r'id="data">(.*?)</script>', page.read_text(), re.DOTALL)[1])


def test_landmarks_come_first_then_boxes_nearest_to_the_threshold(marked):
    asked = questions(marked[0], 300).items
    assert [item.name for item in asked] == [NAME, "landmark 4", "box 4", "box 6", "box 8", "box 9"]
    sign = asked[0]
    assert [view.frame for view in sign.views] == [0, 1]
    assert (sign.color, sign.shape) == ("yellow", "diamond")  # of all views, not of one
    assert sign.margin == pytest.approx(math.log(0.6 / 0.4))
    assert [item.margin for item in asked[2:]] == [0.0, -1.0, -7.0, -11.0]
    few = questions(marked[0], 1)
    assert [item.name for item in few.items[2:]] == ["box 4"]
    assert few.left_out == 5


def test_without_scores_the_outline_tells_how_near_a_box_was():
    distances = [("shape", 3.0), ("unmatched", 2.0), ("sign", 1.0), ("shape", 9.0)]
    rows = [
        observation(0, n, box_at(9), verdict, None) | {"shape_distance": distance}
        for n, (verdict, distance) in enumerate(distances)
    ]
    np.testing.assert_allclose(margins(table_of(OBSERVATIONS, rows)), [-1.0, 0.0, 1.0, -7.0])


def test_the_page_needs_nothing_else_and_names_are_escaped(marked):
    text = marked[1].read_text()
    assert not re.search(r"""(src|href)=["'](?!data:)""", text)
    assert "<b>" not in text
    data = page_data(marked[1])
    assert len(data["items"]) == 6
    assert all(item["image"].startswith("data:image/webp") for item in data["items"])
    left, top, width, height = data["items"][0]["outline"]
    assert 0 <= left < left + width <= 100
    assert 0 <= top < top + height <= 100
    assert set(data["scenes"]) == {"0", "1"}  # one of each image, for all boxes in it
    place = np.array(data["items"][0]["place"]) * [1.6, 1.2, 1.6, 1.2]
    np.testing.assert_allclose(place, [14, 40, 16, 16], atol=0.01)


def test_every_class_has_a_key_of_its_own():
    assert (list(COLOR_KEYS), list(SHAPE_KEYS)) == ([*COLORS, None], [*SHAPES, None])
    keys = [*COLOR_KEYS.values(), *SHAPE_KEYS.values(), *(key for key, _ in KINDS.values())]
    assert len(set(keys)) == len(keys)


def test_marks_become_labels_of_all_views(marked, tmp_path):
    data = page_data(marked[1])
    views = {item["name"]: item["views"] for item in data["items"]}
    said = [(NAME, "sign", "red", None), ("box 6", "not_sign", None, None)]
    marks = {"wayside_marks": 1, "log": data["log"], "reviewer": "Ann"}
    marks["marks"] = [
        {"name": name, "kind": kind, "color": color, "shape": shape, "views": views[name]}
        for name, kind, color, shape in said
    ]
    (tmp_path / "m.json").write_text(json.dumps(marks))
    file = tmp_path / "labels.parquet"
    invoke("label", tmp_path / "m.json", "-o", file)
    labels = read_label_file(file)
    times = pq.read_table(marked[0] / FRAMES.file)["log_time_ns"].to_pylist()
    found = [(one.kind, one.color, one.shape, one.image.frame, one.box) for one in labels.labels]
    assert found == [
        ("sign", "red", None, 0, tuple(box_at(10))),
        ("sign", "red", None, 1, tuple(box_at(14, side=16))),
        ("not_sign", None, None, 1, tuple(box_at(90))),
    ]
    assert [one.image.log_time_ns for one in labels.labels] == [times[0], times[1], times[1]]
    assert {one.source for one in labels.labels} == {"Ann"}
    assert len({one.panel for one in labels.labels}) == 2
    assert not labels.complete


def test_what_stands_in_the_place_of_the_page_is_kept(marked, tmp_path):
    page = tmp_path / "index.html"
    page.write_text("mine")
    with pytest.raises(OutputError, match="--overwrite"):
        invoke("label", marked[0], "-o", tmp_path)
    with pytest.raises(OutputError, match="the page cannot be written"):
        invoke("label", marked[0], "-o", page)
    assert page.read_text() == "mine"
    invoke("label", marked[0], "-o", tmp_path, "--overwrite")
    assert page_data(page)["items"]


@pytest.mark.parametrize("width", [390, 1280])
def test_a_person_marks_by_keyboard_and_goes_on_another_day(marked, in_browser, tmp_path, width):
    profile = tmp_path / "profile"
    first = in_browser(
        marked[1],
        """
        press("s"); press("N"); press("3"); press("d"); press("s"); press("u"); press("b");
        press("ArrowLeft"); press("Backspace"); press("s", document.getElementById("reviewer"));
        const scene = document.querySelector("#scene img");
        await until(() => scene.complete);
        const [outer, inner] = [scene, document.querySelector("#scene .box")].map(one => one.getBoundingClientRect());
        return { saved: saved(), wide: document.documentElement.scrollWidth - innerWidth,
          scene: [scene.naturalWidth, (inner.left - outer.left) / outer.width] };
        """,
        profile=profile,
        width=width,
    )
    look = [(m["name"], m["kind"], m["color"], m["shape"]) for m in first["saved"]["marks"]]
    assert look == [
        (NAME, "sign", "yellow", "diamond"),
        ("landmark 4", "not_sign", None, None),
        ("box 4", "sign", "green", "diamond"),
        ("box 6", "unsure", None, None),
    ]
    assert first["wide"] <= 0
    assert first["scene"] == pytest.approx([160, 120 / 160], abs=0.01)  # box 8
    (tmp_path / "m.json").write_text(json.dumps(first["saved"]))
    assert len(read_labels(tmp_path / "m.json").labels) == 5
    again = in_browser(
        marked[1],
        """
        const before = saved().marks.length, shown = document.getElementById("facts").textContent;
        localStorage.clear(); marks = {};
        const file = new File([SAVED], "m.json");
        await load(file);
        const links = [];
        document.addEventListener("click", event => {
          if (event.target.download) { links.push(event.target.download); event.preventDefault(); }
        });
        document.getElementById("save").click();
        return { before, shown, loaded: saved().marks.length, links };
        """.replace("SAVED", json.dumps(json.dumps(first["saved"]))),
        profile=profile,
    )
    assert again["before"] == again["loaded"] == 4
    assert again["shown"].startswith("5 of 6: box 8")  # the first that is not marked
    assert again["links"] == [f"{STEM}.marks.json"]
