"""Corrections of a result: what a review file may say, and what export, evaluation and labels make of it."""

import csv
import json
import shutil

import pyarrow.parquet as pq
import pytest

from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.labels.wayside_labels import read_label_file
from wayside.pipeline.library import open_inventory
from wayside.pipeline.reviewing.entries import COLUMNS, is_review
from wayside.pipeline.reviewing.known import KnownResult
from wayside.pipeline.reviewing.review import find_review
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.tables import SIGNS

from .results import invoke, observation_row, sign_row, table_of, write_tables

RESULT = "0123456789abcdef"
CSV = f"""{",".join(COLUMNS)}
d-0001,accepted,,,,,,,{RESULT},,Ann
d-0002,rejected,,,,,,,{RESULT},"a bin, not a sign",Ann
d-0003,edited,W3-1,,green,rectangle,,,{RESULT},,Ann
,missing,R1-1,,red,octagon,31.5,4,{RESULT},,Ann
"""
MILE = 1609.344


def sign(number, **changes):
    place = {"x": 10.0 * number, "y": 3.0 * (number % 2), "best_frame": number}
    look = {"color": "white", "shape": "rectangle", "confidence": 0.9, "covariance": [1.0] * 6}
    globe = {"lon_deg": 10 + number * 1e-4, "lat_deg": 50 + (number % 2) * 3e-5, "alt_m": 7.0}
    route = {"route": "US-36", "measure": 12 + 10 * number / MILE, "measure_unit": "mi"}
    along = {"station_m": 10.0 * number}
    return sign_row(f"d-{number:04d}", **place | look | globe | along | route | changes)


def observation(frame, sign_id, verdict="sign"):
    box = [1, 2, 11, 12 + frame]
    return observation_row(frame, frame, box=box, track_id=1, sign_id=sign_id, verdict=verdict)


def frame(number, **changes):
    globe = {"lon_deg": 10 + number * 1e-4, "lat_deg": 50.0, "heading_deg": 90.0}
    where = dict.fromkeys(("x", "station_m"), 10.0 * number) | {"y": 0.0, "z": 1.0}
    about = {"frame": number, "log_time_ns": 100 * number, "status": "used"}
    return about | where | globe | changes


def write_result(folder, signs, observations, frames, name=RESULT):
    about = {"log": "d.mcap", "files": {SIGNS.file: {"sha256": name + "0" * 48}}}
    return write_tables(folder, signs, observations, frames, **about)


@pytest.fixture
def out(tmp_path):
    """A result of four signs, one of them seen from behind, without its log."""
    signs = [sign(1), sign(2), sign(3), sign(4, status="back", color=None)]
    observations = [observation(n, f"d-{n:04d}") for n in (1, 2, 3, 4)]
    observations.append(observation(5, "d-0001", "overlap"))
    return write_result(tmp_path / "out", signs, observations, map(frame, range(6)))


@pytest.fixture
def review(tmp_path):
    file = tmp_path / "review.csv"
    file.write_text(CSV)
    return file


def as_json(path):
    """The same review as the index saves it in JSON."""
    rows = csv.DictReader(CSV.splitlines())
    return save(path, [{name: value or None for name, value in row.items()} for row in rows])


def read(out, *files):
    return find_review(out, files)


def save(path, rows, reviewer="Ann"):
    """Rows of a review as the index saves them."""
    about = {"wayside_review": 1, "log": "d.mcap", "reviewer": reviewer}
    path.write_text(json.dumps(about | {"reviews": rows}))
    return path


def test_an_exported_table_with_reviews_filled_in_is_a_review(out, tmp_path):
    table = tmp_path / "signs.csv"
    invoke("export", out, "-o", table)
    rows = list(csv.DictReader(table.read_text().splitlines()))
    rows[0] |= {"review": "accepted"}
    rows[2] |= {"review": "edited", "final_color": "green", "final_code": "D1"}

    def saved():
        with table.open("w", newline="", encoding="utf-16") as stream:
            writer = csv.DictWriter(stream, list(rows[0]), delimiter=";")
            writer.writeheader()
            writer.writerows(rows)
        return table

    assert is_review(saved())
    said = {name: (one.review, one.look["color"]) for name, one in read(out, table).rows.items()}
    assert said == {"d-0001": ("accepted", "white"), "d-0003": ("edited", "green")}
    rows[2] |= {"final_color": "white", "final_code": "", "color": "white"}
    with pytest.raises(InputError, match="d-0003 is edited, but its final columns are not"):
        read(out, saved())


def test_csv_and_json_say_the_same_and_by_hand_signs_and_verdicts_are_enough(out, review, tmp_path):
    path = tmp_path / "review.json"
    said = read(out, review)
    assert said == read(out, as_json(path))
    reviews = {"d-0001": "accepted", "d-0002": "rejected", "d-0003": "edited"}
    assert {name: one.review for name, one in said.rows.items()} == reviews
    assert [(one.x, one.y, one.look["shape"]) for one in said.missing] == [(31.5, 4.0, "octagon")]
    save(path, [{"sign_id": "d-0001", "review": "accepted"}])
    assert is_review(path)
    assert [one.review for one in read(out, path).rows.values()] == ["accepted"]


def test_final_columns_come_first_and_a_missing_sign_has_its_place_on_road_and_globe(
    out, review, tmp_path
):
    file = tmp_path / "signs.csv"
    words = invoke("export", out, "-o", file, "--all", "--review", review)
    assert "5 rows, 4 of them reviewed" in words
    rows = {row["sign_id"]: row for row in csv.DictReader(file.read_text().splitlines())}
    final = ["final_code", "final_legend", "final_color", "final_shape"]
    assert list(rows["d-0001"])[1:5] == final
    reviews = ["accepted", "rejected", "edited", "", "missing"]
    assert [row["review"] for row in rows.values()] == reviews
    assert [rows["d-0001"][name] for name in final] == ["", "", "white", "rectangle"]
    edited = rows["d-0003"]
    assert [edited[name] for name in final] == ["W3-1", "", "green", "rectangle"]
    assert (edited["color"], edited["reviewer"]) == ("white", "Ann")
    assert rows["d-0002"]["review_note"] == "a bin, not a sign"
    names = ("x", "y", "best_frame", "color", "confidence", "final_shape", "route", "measure_unit")
    missing = rows["d-missing-1"]
    assert [missing[n] for n in names] == ["31.5", "4.0", "3", "", "", "octagon", "US-36", "mi"]
    assert float(missing["measure"]) == pytest.approx(12 + 31.5 / MILE)
    invoke("export", out, "-o", file, "--review", review, "--accepted", "--overwrite")
    kept = [row["sign_id"] for row in csv.DictReader(file.read_text().splitlines())]
    assert kept == ["d-0001", "d-0003", "d-0004", "d-missing-1"]
    geo = tmp_path / "signs.geojson"
    open_inventory(out).export(geo, review=review)
    features = json.loads(geo.read_text())["features"]
    places = {f["properties"]["sign_id"]: f["geometry"]["coordinates"] for f in features}
    assert places["d-0001"] == [10.0001, 50.00003, 7.0]
    north, east = 4 / 111_195, 1.5 / 71_474  # of frame 3, which looks east
    assert places["d-missing-1"] == pytest.approx([10.0003 + east, 50 + north], abs=1e-8)


def test_a_review_evaluates_the_rows_with_status_sign(out, review, tmp_path):
    figures = tmp_path / "figures.json"
    words = invoke("evaluate", out, "--truth", review, "--json", figures)
    assert "3 of 3 rows with status sign: 1 accepted, 1 edited, 1 rejected" in words
    assert "not counted" not in words
    content = json.loads(figures.read_text())
    assert content["precision"] == pytest.approx(2 / 3)
    assert content["recall"] == pytest.approx(2 / 3)
    assert (content["color_right"], content["shape_right"]) == (1, 2)
    rows = [sign(1, shape=None), sign(2), sign(3, color=None)]
    pq.write_table(table_of(SIGNS, rows), out / SIGNS.file)
    words = invoke("evaluate", out, "--truth", review)
    assert "colour     1.000   1 of 1 right" in words  # of those that the row states
    assert "shape      1.000   1 of 1 right" in words
    pq.write_table(table_of(SIGNS, [*rows[:2], sign(3, status="back")]), out / SIGNS.file)
    words = invoke("evaluate", out, "--truth", review)
    assert "not counted: 1 reviewed rows with status back" in words


def test_a_reviewed_result_gives_labels_of_every_measured_view(out, review, tmp_path):
    shutil.copy(review, out / "review.csv")
    file = tmp_path / "labels.parquet"
    assert "1 missing_without_box" in invoke("label", out, "-o", file, status=4)
    labels = read_label_file(file).labels
    assert [(one.image.frame, one.kind, one.color, one.shape) for one in labels] == [
        (1, "sign", "white", "rectangle"),
        (2, "not_sign", None, None),
        (3, "sign", "green", "rectangle"),
    ]
    assert [one.image.log_time_ns for one in labels] == [100, 200, 300]
    assert [one.box for one in labels] == [(1, 2, 11, 12 + n) for n in (1, 2, 3)]
    assert read_labels(out).labels == labels
    for alone in (out / "review.csv", as_json(tmp_path / "review.json")):
        with pytest.raises(UsageError, match=r"this is a review.* give that folder"):
            read_labels(alone)
    (out / "review.csv").unlink()
    with pytest.raises(UsageError, match=r"no review\.json or review\.csv"):
        read_labels(out)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (RESULT, "f" * 16, "of another run"),
        ("d-0001", "d-0009", "no sign d-0009"),
        ("accepted", "good", "'good' among"),
        ("green", "purple", "'purple' among"),
        ("31.5", "", "x and y"),
        ("31.5", "far", "far"),
        ("review", "said", "no column review"),
    ],
)
def test_what_a_review_cannot_say_is_refused(out, review, old, new, words):
    review.write_text(CSV.replace(old, new))
    with pytest.raises(InputError, match=words):
        read(out, review)


@pytest.mark.parametrize(
    ("numbers", "changes", "scale", "first"),
    [
        pytest.param({n: n for n in range(1, 6)}, {"measure": 22.0}, 1.0, 0, id="milepost"),
        pytest.param({2: 1, 3: 2, 4: 3}, {}, 1.2, 0, id="spacing, and two rows are not found"),
        pytest.param({3: 1, 4: 2, 5: 3}, {}, 1.0, 3, id="without the first three images"),
    ],
)
def test_a_review_is_carried_over_to_another_run(tmp_path, numbers, changes, scale, first):
    views = {n: [f for f in (n - 1, n, n + 1) if f < 6] for n in range(1, 6)}
    frames = [frame(n, image_name=f"IMG {n}.jpg") for n in range(6)]
    seen = [
        observation(f, f"d-{n:04d}") | {"box": [40.0 * n, 2, 40.0 * n + 11, 12 + f]}
        for n in views
        for f in views[n]
    ]
    old = write_result(tmp_path / "old", map(sign, range(1, 6)), seen, frames)
    reviews = ["accepted", "rejected", "edited", "accepted", "accepted"]
    rows = [
        row.to_row() | {"review": review, "color": "green" if review == "edited" else "white"}
        for row, review in zip(KnownResult.of(old).rows.values(), reviews, strict=True)
    ]
    gone = {"review": "missing", "x": 41.0, "y": -4.0, "shape": "octagon", "result": RESULT}
    gone["seen"] = [["IMG 1.jpg", 4.0, 31.0], ["IMG 4.jpg", 4.0, 1.0]]
    file = save(tmp_path / "review.json", [*rows, gone])
    kept = [
        frame(f - first, image_name=f"IMG {f}.jpg", x=10.0 * f * scale, log_time_ns=7 + f)
        for f in range(first, 6)
    ]
    found = [sign(n, x=10.0 * o * scale, **changes) for o, n in numbers.items()]
    boxes = [
        one | {"frame": one["frame"] - first, "sign_id": f"d-{n:04d}"}
        for one in seen
        for o, n in numbers.items()
        if one["sign_id"] == f"d-{o:04d}" and one["frame"] >= first
    ]
    said = read(write_result(tmp_path / "new", found, boxes, kept, "f" * 16), file)
    carried = {f"d-{n:04d}": reviews[o - 1] for o, n in numbers.items()}
    assert {name: one.review for name, one in said.rows.items()} == carried
    (missing,) = said.missing
    assert (missing.x, missing.y) == pytest.approx((10 * scale + 31, -4))
    left = [n for n in range(1, 6) if n not in numbers and reviews[n - 1] != "rejected"]
    assert len(said.undecided) == len(left)
    assert said.gone == (2 not in numbers)


def test_a_row_that_is_measured_as_another_sign_is_left_to_a_person(out, tmp_path):
    rows = [row.to_row() for row in KnownResult.of(out).rows.values()]
    rows[0] |= {"color": "red", "result": "f" * 16}
    rows[1] |= {"code": "D1", "result": "f" * 16}
    rows[2] |= {"color": "red", "review": "edited", "result": "f" * 16}
    said = read(out, save(tmp_path / "review.json", rows))
    assert set(said.rows) == {"d-0002", "d-0003", "d-0004"}
    ((measured, edited),) = (one.options for one in said.undecided)
    assert (measured[0], measured[1].review) == ("it is d-0001 as measured", "accepted")
    assert (edited[0], edited[1].review) == ("it is red rectangle", "edited")
    assert measured[1].sign_id == edited[1].sign_id == "d-0001"
    words = invoke("export", out, "-f", "csv", "--review", tmp_path / "review.json")
    assert "1 to decide on the page of `wayside evidence`: d-0001" in words


def test_reviews_of_two_people_are_one_and_contradictions_are_listed(out):
    place = {"review": "missing", "x": 20.0, "y": -4.0}
    ann = [("d-0001", "accepted"), ("d-0002", "accepted"), ("d-0003", "rejected")]
    bob = [("d-0001", "accepted"), ("d-0002", "rejected"), ("d-0004", "accepted")]
    rows = [[{"sign_id": name, "review": review} for name, review in one] for one in (ann, bob)]
    save(out / "review.ann.json", [*rows[0], place | {"color": "red"}])
    assert len(find_review(out).rows) == 3
    save(out / "review.bob.json", [*rows[1], place | {"x": 21.0, "shape": "octagon"}], "Bob")
    said = find_review(out)
    people = {name: (one.review, one.reviewer) for name, one in said.rows.items()}
    assert people == {
        "d-0001": ("accepted", "Ann, Bob"),
        "d-0003": ("rejected", "Ann"),
        "d-0004": ("accepted", "Bob"),
    }
    (missing,) = said.missing
    look = missing.look["color"], missing.look["shape"]
    assert (look, missing.reviewer) == (("red", "octagon"), "Ann, Bob")
    (asked,) = said.undecided
    assert asked.words == "d-0002: reviewers disagree"
    # left open, and run again
    rows = [one.to_row() | {"result": "f" * 16} for _, one in asked.options]
    (again,) = read(out, save(out / "review.json", rows)).undecided
    assert again.words == asked.words
    assert [words for words, _ in asked.options] == [
        "Ann: accepted, white rectangle",
        "Bob: rejected, white rectangle",
    ]
