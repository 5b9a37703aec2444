"""Corrections of a result: what a review file may say, and what export, evaluation and labels make of it."""

import csv
import json
import shutil

import pyarrow.parquet as pq
import pytest

from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.labels.wayside_labels import read_label_file
from wayside.pipeline.reviewing.review import COLUMNS, FILES, find_review, is_review, read_review
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.tables import SIGNS

from .results import invoke, observation_row, sign_row, table_of, write_tables

RESULT = "0123456789abcdef"
CSV = f"""{",".join(COLUMNS)}
{RESULT},d-0001,accepted,,,,,,Ann
{RESULT},d-0002,rejected,,,,,"a bin, not a sign",Ann
{RESULT},d-0003,edited,green,rectangle,,,,Ann
{RESULT},,missing,red,octagon,31.5,4,,Ann
"""


def sign(number, **changes):
    place = {"x": 10.0 * number, "y": 3.0 * (number % 2), "best_frame": number}
    look = {"color": "white", "shape": "rectangle", "confidence": 0.9, "covariance": [1.0] * 6}
    globe = {"lon_deg": 10 + number * 1e-4, "lat_deg": 50 + (number % 2) * 3e-5, "alt_m": 7.0}
    return sign_row(f"d-{number:04d}", **place | look | globe | changes)


def observation(frame, sign_id, verdict="sign"):
    box = [1, 2, 11, 12 + frame]
    return observation_row(frame, frame, box=box, track_id=1, sign_id=sign_id, verdict=verdict)


@pytest.fixture
def out(tmp_path):
    """A result of four signs, one of them seen from behind, without its log."""
    signs = [sign(1), sign(2), sign(3), sign(4, status="back", color=None)]
    observations = [observation(n, f"d-{n:04d}") for n in (1, 2, 3, 4)]
    observations.append(observation(5, "d-0001", "overlap"))
    frames = [
        {"frame": n, "log_time_ns": 100 * n, "status": "used", "y": 0.0, "z": 1.0}
        | dict.fromkeys(("x", "station_m"), 10.0 * n)
        for n in range(6)
    ]
    about = {"log": "d.mcap", "files": {SIGNS.file: {"sha256": RESULT + "0" * 48}}}
    return write_tables(tmp_path / "out", signs, observations, frames, **about)


@pytest.fixture
def review(tmp_path):
    file = tmp_path / "review.csv"
    file.write_text(CSV)
    return file


def as_json(path):
    """The same review as the index saves it in JSON."""
    rows = list(csv.DictReader(CSV.splitlines()))
    reviews = [
        {name: row[name] or None for name in COLUMNS[1:-1]}
        | {axis: float(row[axis]) if row[axis] else None for axis in "xy"}
        for row in rows
    ]
    whole = {"wayside_review": 1, "log": "d.mcap", "result": RESULT, "reviewer": "Ann"}
    path.write_text(json.dumps(whole | {"reviews": reviews}))
    return path


def test_an_exported_table_with_reviews_filled_in_is_a_review(out, tmp_path):
    table = tmp_path / "signs.csv"
    invoke("export", out, "-o", table)
    rows = list(csv.DictReader(table.read_text().splitlines()))
    rows[0] |= {"review": "accepted"}
    rows[2] |= {"review": "edited", "reviewed_color": "green"}

    def saved():
        with table.open("w", newline="", encoding="utf-16") as stream:
            writer = csv.DictWriter(stream, list(rows[0]), delimiter=";")
            writer.writeheader()
            writer.writerows(rows)
        return table

    assert is_review(saved())
    read = read_review(table, out)
    assert {name: (one.review, one.color) for name, one in read.rows.items()} == {
        "d-0001": ("accepted", None),
        "d-0003": ("edited", "green"),
    }
    rows[2] |= {"reviewed_color": "", "color": "green"}  # the colour that was measured
    with pytest.raises(InputError, match="d-0003 is edited, but its reviewed_color"):
        read_review(saved(), out)


def test_csv_and_json_say_the_same_and_by_hand_signs_and_verdicts_are_enough(out, review, tmp_path):
    path = tmp_path / "review.json"
    read = read_review(review, out)
    assert read == read_review(as_json(path), out)
    said = {"d-0001": "accepted", "d-0002": "rejected", "d-0003": "edited"}
    assert {name: one.review for name, one in read.rows.items()} == said
    assert [(one.x, one.y, one.shape) for one in read.missing] == [(31.5, 4.0, "octagon")]
    path.write_text(json.dumps({"reviews": [{"sign_id": "d-0001", "review": "accepted"}]}))
    assert is_review(path)
    assert [one.review for one in read_review(path, out).rows.values()] == ["accepted"]


def test_the_exported_table_has_the_review_beside_what_was_measured(out, review, tmp_path):
    file = tmp_path / "signs.csv"
    assert "5 rows, 4 of them reviewed" in invoke(
        "export", out, "-o", file, "--all", "--review", review
    )
    rows = {row["sign_id"]: row for row in csv.DictReader(file.read_text().splitlines())}
    reviews = ["accepted", "rejected", "edited", "", "missing"]
    assert [row["review"] for row in rows.values()] == reviews
    edited = rows["d-0003"]
    assert (edited["color"], edited["reviewed_color"]) == ("white", "green")
    assert (edited["reviewer"], rows["d-0002"]["review_note"]) == ("Ann", "a bin, not a sign")
    assert (edited["cov_zz"], edited["best_y_max"]) == ("1.0", "9.0")
    names = ("x", "y", "station_m", "best_frame", "color", "confidence", "reviewed_shape")
    missing = [rows["d-missing-1"][name] for name in names]
    assert missing == ["31.5", "4.0", "30.0", "3", "", "", "octagon"]
    plain = tmp_path / "plain.csv"
    invoke("export", out, "-o", plain, "--all")
    measured = [column for column in rows["d-0001"] if "review" not in column]
    for row in csv.DictReader(plain.read_text().splitlines()):
        assert {c: row[c] for c in measured} == {c: rows[row["sign_id"]][c] for c in measured}


def test_geojson_has_longitude_first_and_places_missing_signs_by_the_others(out, review, tmp_path):
    file = tmp_path / "signs.geojson"
    invoke("export", out, "-o", file, "--all", "--review", review)
    content = json.loads(file.read_text())
    places = {f["properties"]["sign_id"]: f["geometry"]["coordinates"] for f in content["features"]}
    assert places["d-0001"] == [10.0001, 50.00003, 7.0]
    assert places["d-missing-1"] == pytest.approx([10 + 31.5e-5, 50 + 4e-5], abs=1e-9)
    rows = [sign(1, lon_deg=None, lat_deg=None, alt_m=None)]
    pq.write_table(table_of(SIGNS, rows), out / SIGNS.file)
    with pytest.raises(UsageError, match="Export CSV"):
        invoke("export", out, "-o", tmp_path / "no fixes.geojson")


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


def test_a_review_in_the_folder_of_the_result_is_taken(out, review, tmp_path):
    assert find_review(out, None).rows == {}
    shutil.copy(review, out / "review.csv")
    assert len(find_review(out, None).rows) == 3
    as_json(out / "review.json")
    with pytest.raises(InputError, match="Choose one with --review"):
        find_review(out, None)
    assert set(FILES) <= {path.name for path in out.iterdir()}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (RESULT, "f" * 16, "of another run"),
        ("d-0001", "d-0009", "no sign d-0009"),
        ("d-0002", "d-0001", "reviewed twice"),
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
        read_review(review, out)
