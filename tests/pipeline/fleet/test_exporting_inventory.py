"""Tables of an inventory as files of other programs, read back by the programs' own libraries."""

import csv
import io
import json
from datetime import datetime
from functools import partial

import numpy as np
import pyarrow.dataset as ds
import pyogrio
import pytest

from wayside.pipeline.exporting.table import inventory_rows
from wayside.pipeline.fleet.merging import merge_inventory
from wayside.schemas.errors import InputError, UsageError

from ..results import invoke, read_by_gdal
from .conftest import drives_of


@pytest.fixture(scope="module")
def inventory(simulation, drive, tmp_path_factory):
    """A road of 3 km seen by two drives: panels in several cells."""
    folder = tmp_path_factory.mktemp("exported")
    rng = np.random.default_rng(4)
    road = simulation.make_road(0, 3000.0, 60.0, rng)
    for day in range(2):
        drive(folder, f"p{day}", road, rng, day=day, quality={})
    assert merge_inventory(drives_of(folder), folder).cells > 1
    return folder


export = partial(invoke, "export")


def merged(inventory, table):
    """The rows of the Parquet parts, by their first column."""
    rows = ds.dataset(inventory / table).to_table().to_pylist()
    return {next(iter(row.values())): row for row in rows}


@pytest.mark.parametrize("kind", ["csv", "geojson", "gpkg", "fgb", "shp", "kml", "xlsx"])
@pytest.mark.parametrize("table", ["panels", "supports"])
def test_every_row_of_every_cell_is_exported_where_it_lies(inventory, tmp_path, kind, table):
    wanted = merged(inventory, table)
    file = tmp_path / f"out.{kind}"
    assert f"{len(wanted)} rows" in export(inventory, "-o", file, "--table", table)
    key = f"{table[:-1]}_id"
    if kind in ("csv", "xlsx"):
        read = csv.DictReader(io.StringIO(file.read_text())) if kind == "csv" else None
        rows = list(read or pyogrio.read_arrow(file)[1].to_pylist())
        points = np.array([[float(row[n]) for n in ("lon_deg", "lat_deg")] for row in rows])
    else:
        _, found, points = read_by_gdal(file)
        rows = found.to_pylist()
    names = [row["Name" if kind == "kml" else key] for row in rows]
    assert sorted(names) == sorted(wanted)
    places = [[wanted[name]["lon_deg"], wanted[name]["lat_deg"]] for name in names]
    np.testing.assert_allclose(points[:, :2], places, atol=1e-9)


def test_history_and_covariance_are_single_values(inventory, tmp_path):
    file = tmp_path / "panels.gpkg"
    export(inventory, "-o", file, "--all")
    meta, found, _ = read_by_gdal(file)
    assert pyogrio.list_layers(file)[0, 0] == "panels"
    assert meta["crs"] == "EPSG:4326"
    wanted = merged(inventory, "panels")
    for row in found.to_pylist():
        panel = wanted[row["panel_id"]]
        assert row["drives"] == ", ".join(panel["drives"])
        assert row["cov_ee"] == pytest.approx(panel["covariance"][0], abs=1e-6)
        assert (row["color"], row["times_seen"]) == (panel["color"], panel["times_seen"])
        assert abs((row["first_seen"] - panel["first_seen"]).total_seconds()) < 0.001
    export(inventory, "-o", file.with_suffix(".csv"), "--all")
    first = next(csv.DictReader(io.StringIO(file.with_suffix(".csv").read_text())))
    assert datetime.fromisoformat(first["first_seen"]) == wanted[first["panel_id"]]["first_seen"]


def test_one_cell_is_read_at_a_time(inventory):
    cells = len(list((inventory / "panels").glob("cell=*")))
    source = inventory_rows(inventory, "panels")
    assert [len(chunk) > 0 for chunk in source.chunks()] == [True] * cells


def test_without_a_name_the_file_is_that_of_the_table_and_bytes_repeat(inventory):
    for table in ("panels", "supports"):
        assert str(inventory / f"{table}.shp") in export(inventory, "-f", "shp", "--table", table)
        before = {path: path.read_bytes() for path in inventory.glob(f"{table}.*")}
        export(inventory, "-f", "shp", "--table", table)  # the same bytes are never refused
        assert before == {path: path.read_bytes() for path in inventory.glob(f"{table}.*")}
    assert len(merged(inventory, "panels")) > 0  # the folders of the tables stand beside


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["-f", "mcap"], "-f mcap takes the result of one drive"),
        (["-f", "csv", "--review", "review.csv"], "Leave them out"),
    ],
)
def test_what_an_inventory_has_not_is_refused(inventory, options, words):
    with pytest.raises(UsageError, match=words):
        export(inventory, *options)


def test_a_table_of_a_drive_is_refused_and_the_drive_exported_as_before(inventory, tmp_path):
    drive = inventory / "drives" / "p0"
    with pytest.raises(UsageError, match="Leave --table out"):
        export(drive, "-f", "csv", "--table", "panels")
    export(drive, "-o", tmp_path / "signs.geojson")
    features = json.loads((tmp_path / "signs.geojson").read_text())["features"]
    assert features[0]["properties"]["sign_id"].startswith("p0-")


def test_what_is_no_result_is_told_as_unusable_input(tmp_path):
    for name in ("absent", "a" * 5000):
        with pytest.raises(InputError, match="there is no folder"):
            export(tmp_path / name, "-f", "csv")
    (tmp_path / "drives").mkdir()
    with pytest.raises(InputError, match="nothing is merged yet"):
        export(tmp_path, "-f", "csv")
