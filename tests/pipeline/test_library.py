"""wayside as a library: the page docs/library.md runs, and what it says holds."""

import ast
import contextlib
import io
import json
import os
import re
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import wayside
from wayside.pipeline.files.settings_file import load_settings
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "recordings" / "demo.mcap"
SHORT = {"read.until_s": 0.3}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """What the code of docs/library.md leaves behind: its names, the folder it ran in and what it printed."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "recordings").symlink_to(ROOT / "recordings")
    names = {}
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        text = (ROOT / "docs" / "library.md").read_text("utf-8")
        for block in re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            exec(compile(block, "docs/library.md", "exec"), names)
        yield names | {"folder": folder, "printed": printed.getvalue()}


def test_the_page_finds_signs_and_shows_them(page):
    assert page["certain"].num_rows >= 3
    assert page["verdicts"]["sign"] == page["signs"].num_rows
    assert page["views"].num_rows == page["signs"].num_rows
    assert 0 < page["used"] < page["inventory"].frames.num_rows
    assert "'color': 'white'" in page["printed"]
    assert "did you mean segment.clusters" in page["printed"]
    assert wayside.__version__ in page["printed"]
    assert list(page["inventory"]) == list(page["again"]) == []  # no frame is left


def test_the_notebook_shows_the_signs_and_hands_them_on(tmp_path, monkeypatch):
    (tmp_path / "docs").mkdir()
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    monkeypatch.chdir(tmp_path / "docs")
    names, shown = {}, []
    for cell in json.loads((ROOT / "docs" / "notebook.ipynb").read_text("utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            *body, last = ast.parse("".join(cell["source"])).body
            exec(compile(ast.Module(body, []), "notebook", "exec"), names)
            shown.append(eval(compile(ast.Expression(last.value), "notebook", "eval"), names))
    inventory, points, files, again = shown
    html, signs = inventory._repr_html_(), inventory.signs.to_pylist()
    assert len(signs) == len(again) > 3
    assert html.count("<circle") == html.count("<tr id=") == len(signs)
    assert ">north</text>" in html
    assert points["sign_id"].tolist() == [row["sign_id"] for row in signs]
    assert points.geometry.y.tolist() == [row["lat_deg"] for row in signs]
    assert points.crs == "EPSG:4326"
    assert [file.is_file() for file in files] == [True, True]
    assert "ft right" in files[0].read_text("utf-8")


@pytest.mark.parametrize("table", [SIGNS, OBSERVATIONS, FRAMES], ids=lambda t: t.file)
def test_tables_are_those_of_the_folder(page, table):
    written = pq.read_table(page["folder"] / "out" / "library" / table.file)
    for inventory in (page["inventory"], page["again"]):
        found = getattr(inventory, table.file.removesuffix(".parquet"))
        assert found.equals(written)
        assert found.schema.equals(table.schema)


def test_an_export_heeds_the_review_that_is_given(page, tmp_path):
    first = page["signs"]["sign_id"][0].as_py()
    (tmp_path / "review.csv").write_text(f"sign_id,review\n{first},rejected\n")
    more = {"review": tmp_path / "review.csv", "accepted": True}
    assert first not in page["again"].export(tmp_path / "signs.csv", **more).read_text()


def test_without_a_folder_nothing_stays_on_disk(tmp_path, monkeypatch):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    monkeypatch.chdir(tmp_path)
    steps = []
    inventory = wayside.run(DEMO, settings=SHORT, progress=steps.append)
    assert steps == []
    next(inventory)
    assert len(steps) == 1
    count = inventory.frames.num_rows
    assert [step.frames for step in steps] == list(range(1, count + 1))
    assert all(0 < step.fraction <= 1 for step in steps)
    assert inventory.about["settings"]["read"]["until_s"] == SHORT["read.until_s"]
    assert "<svg" in inventory._repr_html_()
    for write in (inventory.evidence, lambda: inventory.export("signs.csv")):
        with pytest.raises(UsageError, match="the folder out"):
            write()
    assert os.listdir(tmp_path) == ["scratch"]
    assert os.listdir(scratch) == []


def test_the_roadside_is_measured_only_where_it_is_asked_for(tmp_path, command):
    road = json.loads(DEMO.with_suffix(".truth.json").read_text())["road"]
    lane = road["travel_offset_m"]
    chosen = {"roadside.on": True, "read.until_s": 4.5}
    inventory = wayside.run(DEMO, settings=chosen, out=tmp_path).finish()
    profile = inventory.profile.to_pylist()
    assert wayside.open_inventory(tmp_path).sections.num_rows == 2 * len(profile) / 25
    assert inventory.about["files"]["profile.parquet"]["rows"] == len(profile)
    beside = []
    for row in profile:
        truth = np.interp([lane + row["offset_m"], lane], *np.transpose(road["cross_section"]))
        if row["status"] == "ground":
            beside.append(row["height_m"] - (truth[0] - truth[1]))
    assert len(beside) > 0.3 * len(profile)
    assert np.median(np.abs(beside)) < 0.05
    edges = [row["edge_m"] for row in inventory.sections.to_pylist() if row["side"] == "right"]
    assert np.nanmedian(np.array(edges, float)) == pytest.approx(3.5 - lane, abs=0.15)
    posts = inventory.posts.to_pylist()
    assert {row["assembly_id"] for row in posts} == {*inventory.signs["assembly_id"].to_pylist()}
    seen = [row for row in posts if row["number"]]
    assert {row["number"] for row in seen} == {1, 2}
    assert all(0.03 < row["width_m"] < 0.2 for row in seen)
    for table, rows in {"profile": profile, "posts": posts}.items():
        done = command("export", tmp_path, "--table", table, "-o", tmp_path / f"{table}.csv")
        assert f"{len(rows)} rows" in done.stdout, done.stderr
    plain = wayside.run(DEMO, settings={"read.until_s": 4.5}, out=tmp_path)
    assert plain.finish().about["files"].keys() == {t.file for t in (SIGNS, OBSERVATIONS, FRAMES)}
    assert not (tmp_path / "profile.parquet").exists()  # of the run before
    with pytest.raises(InputError, match="profile"):
        plain.profile  # noqa: B018


def test_a_log_that_is_not_there_is_told_at_every_access(tmp_path):
    inventory = wayside.run(tmp_path / "none.mcap")
    for _ in range(2):
        with pytest.raises(InputError, match="none"):
            inventory.finish()


def test_what_excludes_each_other_is_refused(tmp_path):
    chosen, _ = load_settings("report")
    with pytest.raises(UsageError, match="preset"):
        wayside.run(DEMO, preset="report", settings=chosen)
    with pytest.raises(UsageError, match="Give out"):
        wayside.run(DEMO, view="file")
    with pytest.raises(UsageError, match="did you mean"):
        wayside.run(DEMO, settings={"read.spacing": 8})
    with pytest.raises(InputError, match="not a result folder"):
        wayside.open_inventory(tmp_path)


def test_importing_wayside_loads_nothing_heavy(python):
    code = "import sys, wayside; print({'cv2', 'numba', 'pyarrow', 'rerun'} & set(sys.modules))"
    assert python(code).stdout.strip() == "set()"
