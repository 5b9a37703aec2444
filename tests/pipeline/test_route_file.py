"""Files of route lines, written by GDAL and pyarrow."""

import csv
import json
import struct
import warnings

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import pyproj
import pytest

from wayside.pipeline.cli.options import parse_milepost, settings_of
from wayside.pipeline.files.route_file import open_routes, route_notes
from wayside.pipeline.files.settings_file import load_settings
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.settings import RouteSettings

from .results import invoke, sign_row, write_tables

LINE = [(-98.87, 38.88, 12.0), (-98.86, 38.881, 12.6), (-98.85, 38.882, 13.2)]
OTHER = [(-97.0, 38.0, 1.0), (-96.9, 38.0, 2.0)]
PLACES = np.array([[-98.869, 38.8801], [-98.865, 38.8805]])


def wkb(points, kind=2002):
    numbers = b"".join(struct.pack(f"<{len(point)}d", *point) for point in points)
    return struct.pack("<BII", 1, kind, len(points)) + numbers


def write(file, lines, column="RTE_NM", names=("US-36 EB", "K-7"), crs="OGC:CRS84"):
    """Lines of WGS 84 in a file of another reference system."""
    table = pa.table({column: list(names), "geometry": pa.array(lines, pa.binary())})
    if file.suffix == ".parquet":
        about = {"version": "1.1.0", "primary_column": "geometry"}
        about["columns"] = {"geometry": {"encoding": "WKB", "geometry_types": [], "crs": crs}}
        with pq.ParquetWriter(file, table.schema) as writer:
            writer.write_table(table)
            # as GDAL does: not in the schema
            writer.add_key_value_metadata({"geo": json.dumps(about)})
        return file
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the writer does not know lines with measures by name
        kind = {"geometry_name": "geometry", "geometry_type": "LineString"}
        pyogrio.write_arrow(table, file, driver="GPKG", crs=crs, **kind)
    return file


def projected(points):
    to_utm = pyproj.Transformer.from_crs("OGC:CRS84", "EPSG:26914", always_xy=True)
    return [(*to_utm.transform(x, y), m) for x, y, m in points]


@pytest.fixture(params=["gpkg", "parquet"])
def network(request, tmp_path):
    """Two routes far apart, in UTM, the first in two parts with a vertex that has no measure."""
    first = [*LINE, (-98.84, 38.883, float("nan"))]
    parts = struct.pack("<BII", 1, 2005, 2) + wkb(projected(first[:2])) + wkb(projected(first[1:]))
    utm = pyproj.CRS("EPSG:26914")
    crs = utm.to_json_dict() if request.param == "parquet" else utm.to_wkt()
    return write(tmp_path / f"network.{request.param}", [parts, wkb(projected(OTHER))], crs=crs)


def test_pieces_with_measures_near_the_drive_come_in_degrees(network):
    file = open_routes(RouteSettings(file=str(network), unit="km"))
    found = file.near(PLACES)
    assert (found.names, found.unit) == (("US-36 EB",), "km")
    np.testing.assert_allclose(found.start, [LINE[0][:2]], atol=1e-9)
    np.testing.assert_allclose(found.end, [LINE[1][:2]], atol=1e-9)
    assert (found.start_measure.tolist(), found.end_measure.tolist()) == ([12.0], [12.6])
    everywhere = file.near(np.array([[-99.0, 37.9], [-96.0, 39.0]]))
    assert everywhere.names == ("K-7", "US-36 EB")
    assert sorted(everywhere.end_measure.tolist()) == [2.0, 12.6, 13.2]


def test_only_the_route_that_is_named_counts(network):
    assert len(open_routes(RouteSettings(file=str(network), name="K-7")).near(PLACES)) == 0
    with pytest.raises(UsageError, match="the nearest: US-36 EB"):
        open_routes(RouteSettings(file=str(network), name="US-36 WB"))


def test_what_is_no_network_with_measures_is_refused_in_words(tmp_path):
    def refusal(file, kind=InputError, **settings):
        with pytest.raises(kind) as error:
            open_routes(RouteSettings(file=str(file), **settings))
        return str(error.value)

    flat = [wkb([point[:2] for point in line], 2) for line in (LINE, OTHER)]
    file = write(tmp_path / "flat.gpkg", flat)
    assert "measures (M), but the file holds LineString" in refusal(file)
    assert "no such file" in refusal(tmp_path / "none.gpkg")
    (tmp_path / "text.gpkg").write_text("no database")
    assert "cannot be read" in refusal(tmp_path / "text.gpkg")
    pq.write_table(pa.table({"route": ["a"]}), tmp_path / "plain.parquet")
    assert "geopandas" in refusal(tmp_path / "plain.parquet")
    nowhere = write(tmp_path / "nowhere.parquet", [wkb(LINE), wkb(OTHER)], crs=None)
    assert "coordinate reference system" in refusal(nowhere)
    unnamed = write(tmp_path / "unnamed.parquet", [wkb(LINE), wkb(OTHER)], column="code")
    assert "--set route.column" in refusal(unnamed, UsageError)
    assert open_routes(RouteSettings(file=str(unnamed), column="CODE")).column == "code"


def test_signs_without_a_route_are_counted():
    signs = ["K-7", None, None]
    settings = RouteSettings(file="network.gpkg")
    (note,) = route_notes(settings, signs)
    assert "2 of 3 signs have no route" in note
    assert "no satellite fixes" in route_notes(settings, signs, on_globe=False)[0]
    assert route_notes(settings, signs[:1]) == []
    assert route_notes(RouteSettings(), signs) == []


def test_a_milepost_may_name_its_unit():
    assert parse_milepost("12.35") == {"route.milepost": 12.35}
    assert parse_milepost("0") == {"route.milepost": 0.0}
    assert parse_milepost("12.35 mi") == {"route.milepost": 12.35, "route.unit": "mi"}
    assert parse_milepost("19.875km") == {"route.milepost": 19.875, "route.unit": "km"}
    for text in ("", "-3", "12,35", "12.35 leagues", "mile 12"):
        with pytest.raises(UsageError, match=r"12\.35 \(miles\)"):
            parse_milepost(text)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("US-36", None, False, None), "Add --milepost"),
        ((None, "12.35", False, None), "Add --route"),
        (("US-36", "12.35", False, "a.gpkg"), "are given. Give one"),
        (("US-36", None, True, "a.gpkg"), "need no direction"),
    ],
)
def test_options_that_do_not_go_together_are_refused(given, words):
    names = ("route", "milepost", "decreasing", "routes")
    with pytest.raises(UsageError, match=words):
        load_settings(options=settings_of(dict(zip(names, given, strict=True))))
    with pytest.raises(UsageError, match="--milepost: 2 logs are given"):
        invoke("run", "a.mcap", "b.mcap", "-o", "out", "--milepost", "12.35")


def test_a_milepost_is_a_place_on_its_route(network):
    lines = open_routes(RouteSettings(file=str(network)))
    found = lines.places([("US-36 EB", 12.3), ("K-7", 1.5)])
    np.testing.assert_allclose(found, [(38.8805, -98.865), (38.0, -96.95)], atol=1e-6)
    with pytest.raises(ValueError, match="US-36 EB has no measure 99"):
        lines.places([("US-36 EB", 99.0)])


def test_lines_given_for_a_result_measure_its_rows(network, tmp_path):
    """Of a drive along the first piece of a line; a sign stands in its middle, another where no line is followed."""
    about = {"log_time_ns": 0, "status": "used"}
    frames = [
        about | {"frame": n, "station_m": 874.0 * n, "lon_deg": lon, "lat_deg": lat}
        for n, (lon, lat, _) in enumerate(LINE[:2])
    ]
    places = {"lon_deg": -98.865, "lat_deg": 38.88}
    signs = [sign_row(f"d-{n}", station_m=at, **places) for n, at in enumerate((437.0, 9e3))]
    out = write_tables(tmp_path / "out", signs, frames=frames, log="d.mcap")
    said = invoke("export", out, "-f", "csv", "--routes", network)
    assert "note: 1 of 2 signs have no route" in said
    first, second = csv.DictReader((out / "signs.csv").read_text().splitlines())
    assert (first["route"], first["measure_unit"], second["route"]) == ("US-36 EB", "mi", "")
    assert float(first["measure"]) == pytest.approx(12.3, abs=2e-3)
    write_tables(out, signs, frames=[about | {"frame": 0}])
    with pytest.raises(InputError, match="no satellite fixes"):
        invoke("evidence", out, "--routes", network)
