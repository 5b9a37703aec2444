"""Questions about an inventory of two drives, those of the documentation among them."""

import csv
import io
import json
import re
import shutil
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wayside.pipeline.fleet.manifest import Entry, Manifest, write_manifest
from wayside.schemas.errors import InputError, UsageError

from ..results import invoke, sign_row, write_tables

pytest.importorskip("duckdb", reason="wayside[query] is not installed")
from wayside.pipeline.fleet.query import FORMATS, first_rows, write_answer

DOCUMENT = Path(__file__).parents[3] / "docs" / "fleet.md"


def write(path, rows):
    path.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(rows), path)


@pytest.fixture
def inventory(tmp_path):
    """Two drives that saw one panel each, a third without a result, and an older result that does not count."""
    for name, height in (("one", 0.7), ("two", 0.8), ("old", 9.0)):
        look = {"color": "yellow", "geometry": b"\x01", "panel_height_m": height, "views": 3}
        frames = [{"frame": 0, "log_time_ns": 5, "status": "undecodable"}]
        (tmp_path / "drives").mkdir(exist_ok=True)
        look |= {"next_sign_id": "d-0002", "spacing_m": 50 + height, "sigma_spacing_m": height}
        write_tables(tmp_path / "drives" / name, [sign_row("d-0001", **look)], frames=frames)
    sightings = [
        {"panel_id": f"one/d-000{number}", "drive": drive, "sign_id": f"d-000{number}"}
        for drive in ("one", "two")
        for number in (1, 2)
    ]
    write(tmp_path / "sightings" / "cell=0231" / "part-0.parquet", sightings)
    panel = {"panel_id": "one/d-0001", "status": "sign", "color": "yellow", "shape": "diamond"}
    panel |= {"panel_height_m": 0.75, "times_seen": 2, "lon_deg": -98.5, "lat_deg": 38.5}
    panel |= {"last_seen": datetime(2024, 5, 1, tzinfo=UTC), "sigma_east_m": 0.9}
    write(tmp_path / "panels" / "cell=0231" / "part-0.parquet", [panel | {"sigma_north_m": 0.4}])
    logs = [Entry(n, f"/{n}.mcap", n, 9, n, "done", seconds=2.5) for n in ("one", "two")]
    logs.append(Entry("old", "/old.mcap", "old", 9, "old", "quarantined"))
    write_manifest(tmp_path, Manifest().with_entries(logs))
    return tmp_path


def test_the_checks_of_all_drives_are_one_view(inventory):
    with pytest.raises(InputError, match="there are no checks: `wayside check` compares signs"):
        first_rows(inventory, "FROM checks", 9)
    invoke("check", inventory, "--only", "offset", status=4)  # their logs are not there
    _, rows = first_rows(inventory, "SELECT drive, sign_id, verdict FROM checks ORDER BY drive", 9)
    assert rows == [[drive, "d-0001", "not checkable"] for drive in ("one", "two")]


def test_the_questions_of_the_documentation_are_answered(inventory):
    questions = re.findall(r"^-- .*?\n(?=\n|```)", DOCUMENT.read_text(), re.DOTALL | re.MULTILINE)
    assert len(questions) == 5
    answers = [first_rows(inventory, question, 9) for question in questions]
    assert [rows[0][0] for _, rows in answers] == ["yellow", *["one/d-0001"] * 4, "one"]
    assert answers[4][1] == [["one/d-0001", "one/d-0002", "50.7", "0.7"]]
    names, rows = answers[3]
    assert names == ["panel_id", "drives", "height_m", "scatter_m", "seen_by"]
    assert rows[0] == ["one/d-0001", "2", "0.75", "0.071", "one, two"]


def test_the_ground_is_that_of_the_drives_that_were_asked_for_it(inventory):
    with pytest.raises(InputError, match=r"roadside\.on"):
        first_rows(inventory, "SELECT * FROM profile", 9)
    strip = {"station_m": 8.0, "offset_m": 3.0, "height_m": -0.2, "count": 2, "frame": 1}
    rows = pa.Table.from_pylist([strip | {"status": "ground"}])
    pq.write_table(rows, inventory / "drives" / "two" / "profile.parquet")
    assert first_rows(inventory, "SELECT drive, height_m FROM profile", 9)[1] == [["two", "-0.2"]]


def test_only_results_that_are_done_count_and_cells_keep_their_zeros(inventory):
    assert first_rows(inventory, "SELECT drive FROM signs ORDER BY 1;", 9)[1] == [["one"], ["two"]]
    assert first_rows(inventory, "SELECT cell FROM panels", 9)[1] == [["0231"]]


@pytest.mark.parametrize("name", ["a[1]", "color=red", "b\\c", "s*", "q?", "[!a]", "it's", "**"])
def test_the_path_of_an_inventory_is_neither_a_pattern_nor_a_column(inventory, tmp_path, name):
    parent = tmp_path / "parent"
    for other in {name, "a1", "sx", "b", "plain"}:
        shutil.copytree(inventory / "drives", parent / other / "drives")
        for table in ("panels", "sightings"):
            shutil.copytree(inventory / table, parent / other / table)
        shutil.copy(inventory / "fleet.json", parent / other)
    plain, named = parent / "plain", parent / name
    for view in ("panels", "sightings", "signs", "frames"):
        question = f"FROM {view} ORDER BY ALL"
        assert first_rows(named, question, 99) == first_rows(plain, question, 99)


def test_a_path_that_the_database_cannot_open_is_told(inventory, tmp_path):
    folder = tmp_path / "b\\c[1]"
    for name in ("drives", "panels"):
        shutil.copytree(inventory / name, folder / name)
    shutil.copy(inventory / "fleet.json", folder)
    with pytest.raises(InputError, match="backslash"):
        first_rows(folder, "FROM panels", 1)


@pytest.mark.parametrize("kind", ["csv", "json", "parquet"])
def test_every_format_reads_back(inventory, kind):
    stream = io.BytesIO()
    write_answer(inventory, "FROM signs ORDER BY drive", stream, kind)
    stream.seek(0)
    if kind == "parquet":
        rows = pq.read_table(stream).to_pylist()
    elif kind == "json":
        rows = json.load(stream)
    else:
        rows = list(csv.DictReader(io.TextIOWrapper(stream)))
    assert [row["drive"] for row in rows] == ["one", "two"]
    assert [float(row["panel_height_m"]) for row in rows] == pytest.approx([0.7, 0.8])


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        ("DROP VIEW panels", "one statement that reads"),
        ("SELECT 1; SELECT 2", "one statement that reads"),
        ("COPY panels TO '{folder}/x.csv'", "one statement that reads"),
        ("WITH t AS (COPY (SELECT 1) TO '{folder}/x.csv') SELECT 1", "cannot be answered"),
        ("FROM enable_profiling(save_location := '{folder}/x.json')", "cannot be answered"),
        ("FROM enable_logging(storage_path := '{folder}')", "cannot be answered"),
    ],
)
def test_a_question_that_does_not_only_read_is_refused_and_writes_nothing(
    inventory, tmp_path_factory, sql, words
):
    folder = tmp_path_factory.mktemp("other")
    before = sorted(inventory.rglob("*"))
    question = sql.format(folder=folder)
    with pytest.raises(UsageError, match=words):
        first_rows(inventory, question, 1)
    for kind in FORMATS:
        with pytest.raises(UsageError, match=words):
            write_answer(inventory, question, io.BytesIO(), kind)
    assert not list(folder.iterdir())
    assert sorted(inventory.rglob("*")) == before


def test_what_is_not_there_is_told(inventory, tmp_path):
    with pytest.raises(UsageError, match=r"views: panels.*DESCRIBE"):
        first_rows(inventory, "FROM pannels", 1)
    with pytest.raises(InputError, match="there are no changes"):
        first_rows(inventory, "FROM changes", 1)
    with pytest.raises(InputError, match="no inventory"):
        first_rows(tmp_path / "none", "FROM panels", 1)


def test_the_command_prints_a_table_and_keeps_files_of_the_user(command, inventory):
    run = partial(command, "query", inventory)
    many = run("SELECT range AS number FROM range(41)").stdout
    assert "number" in many.splitlines()[0]
    assert "... and more" in many
    assert run("SELECT drive FROM signs ORDER BY 1", "-f", "csv").stdout == "drive\none\ntwo\n"
    file = inventory / "answer.csv"
    assert run("SELECT 1 AS a", "-o", file).returncode == 0
    assert run("SELECT 2 AS a", "-o", file).returncode != 0
    assert file.read_text() == "a\n1\n"
    assert run("SELECT 2 AS a", "-o", file.with_suffix(".xls")).returncode != 0


def test_an_answer_as_csv_holds_no_formula(inventory):
    question = """SELECT '=1+1' AS "@name", -1 AS n, '-2' AS n, ['=3'] AS list,
        '@e'::ENUM ('@e', 'f') AS kind FROM logs LIMIT 1"""
    answer = io.BytesIO()
    write_answer(inventory, question, answer, "csv")
    names, row = csv.reader(io.StringIO(answer.getvalue().decode()))
    assert names[:2] == ["'@name", "n"]
    assert row == ["'=1+1", "-1", "'-2", "['=3']", "'@e"]
