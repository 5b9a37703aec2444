"""Signs of a result as files of other programs, read back by the programs' own libraries."""

import csv
import errno
import io
import itertools
import shutil
import sqlite3
import sys
from functools import partial
from zipfile import ZipFile

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.exporting.place import SHORT_NAME, short_names
from wayside.schemas.errors import OutputError, UsageError
from wayside.schemas.tables import SIGNS, Column

from .results import frame_rows, invoke, make_log, read_by_gdal, sign_row, write_tables

TIME_NS = 1_718_031_601_357_243_738
LON, LAT, ALT = -98.8585, 38.8792, 568.9
UTM = "EPSG:26914"


def write_result(folder, **changes):
    """A result of two signs, one of them without a colour."""
    row = {"shape": "octagon", "confidence": 0.9, "views": 3, "best_time_ns": TIME_NS}
    row |= {"date": TIME_NS // 1000}
    row |= {"y": 3.0, "z": 1.5, "covariance": [1, 0, 0, 4, 0, 9], "lat_deg": LAT, "alt_m": ALT}
    row |= {"panel_width_m": 0.762, "station_m": 304.8, "residual_px": 0.5, "facing_deg": 2.0}
    row |= {"route": "US-36 EB", "measure": 12.35, "measure_unit": "mi"}
    rows = []
    for number, color in ((1, "red"), (2, None)):
        own = {"x": 10.0 * number, "color": color, "lon_deg": LON + number * 1e-4}
        rows.append(sign_row(f"d-{number:04d}", **row | own | {"best_frame": number} | changes))
    frame = {"frame": 0, "log_time_ns": 0, "status": "used"}
    frame |= dict.fromkeys(("x", "y", "z", "station_m"), 0.0)
    about = {"log": "d.mcap", "world": "drive_start", "files": {SIGNS.file: {"sha256": "0" * 64}}}
    return write_tables(folder, rows, frames=[frame], **about)


@pytest.fixture
def out(tmp_path):
    return write_result(tmp_path / "out")


@pytest.fixture
def local(tmp_path):
    """A result without fixes."""
    return write_result(tmp_path / "local", lon_deg=None, lat_deg=None, alt_m=None)


export = partial(invoke, "export")


def read_csv(file):
    return list(csv.DictReader(io.StringIO(file.read_text())))


@pytest.mark.parametrize("kind", ["csv", "xlsx"])
def test_a_text_that_would_be_a_formula_gets_an_apostrophe_and_a_number_stays(tmp_path, kind):
    out = write_result(tmp_path / "out", log='=cmd|"x"', y=-1.5)
    export(out, "-f", kind, "--all")
    file = out / f"signs.{kind}"
    row = read_csv(file)[0] if kind == "csv" else pyogrio.read_arrow(file)[1].to_pylist()[0]
    assert (row["log"], float(row["y"])) == ('\'=cmd|"x"', -1.5)


def test_twenty_columns_of_short_numbers_are_exported_with_links_and_the_review(out, local):
    export(out, "-f", "csv")
    row = read_csv(out / "signs.csv")[0]
    ours = ("review", "final_", "result")
    *measured, name, sheet = [column for column in row if not column.startswith(ours)]
    assert (len(measured), name, sheet) == (20, "image_name", "evidence")
    assert (row["confidence"], row["lon_deg"]) == ("0.9", "-98.8584")
    assert row["date"] == "2024-06-10T15:00:01.357243+00:00"
    export(local, "-f", "csv")
    row = read_csv(local / "signs.csv")[0]
    assert (row["x"], row["y"], row["facing_deg"]) == ("10.0", "3.0", "2.0")
    assert "lon_deg" not in row


def test_pictures_and_sheets_come_along(tmp_path):
    red = np.full((120, 160, 3), (200, 30, 40), np.uint8)
    log = make_log(tmp_path / "d.mcap", [red, red // 2])
    frames = frame_rows(log, y=0.0, z=1.5)
    seen = {"best_frame": 1, "best_box": [60.0, 40.0, 80.0, 60.0]}
    out = write_result(tmp_path / "out", **seen, mutcd="R1-1")
    settings = {"read": {"spacing_m": 8.0, "thin_m": 0.0}}
    rows = pq.read_table(out / SIGNS.file).to_pylist()
    frames = [frame | {"image_name": f"{frame['frame']:03d}.png"} for frame in frames]
    write_tables(out, rows, frames=frames, log="d.mcap", log_path=str(log), settings=settings)
    (out / "evidence").mkdir()
    (out / "evidence" / "d-0001.html").write_text("")
    for kind in ("gpkg", "kmz"):
        export(out, "-f", kind, "--pictures")
    first, second = read_by_gdal(out / "signs.gpkg")[1].to_pylist()
    assert (first["image_name"], second["evidence"]) == ("001.png", None)
    assert first["evidence"] == "evidence/d-0001.html"
    balloon = read_by_gdal(out / "signs.kmz")[1].to_pylist()[0]["description"]
    with ZipFile(out / "signs.kmz") as archive:
        jpeg = archive.read("images/d-0001.jpg")
    assert balloon == '<img src="images/d-0001.jpg"><br>red octagon R1-1'
    export(out, "-f", "kml")
    assert '<a href="evidence/d-0001.html">' in (out / "signs.kml").read_text()
    for content in (jpeg, first["picture"]):
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR_RGB)
        assert image.shape == (240, 320, 3)
        np.testing.assert_allclose(image[5, 5], [100, 15, 20], atol=6)


def test_a_route_given_at_the_export_is_that_of_the_rows_and_the_result_stays(out, tmp_path):
    route = ["--route", "K-18", "--milepost", "100km", "--decreasing"]
    export(out, "-f", "csv", *route)
    rows = read_csv(out / "signs.csv")
    shown = {(row["route"], float(row["measure"]), row["measure_unit"]) for row in rows}
    assert shown == {("K-18", 100 - 0.3048, "km")}
    export(out, "-o", tmp_path / "before.csv")
    assert read_csv(tmp_path / "before.csv")[0]["route"] == "US-36 EB"
    with pytest.raises(UsageError, match="its route is missing"):
        export(out, "-f", "csv", *route[2:])


def test_a_geopackage_has_every_column_with_its_words_and_the_measured_place(out):
    assert "signs.gpkg: 2 rows" in export(out, "-f", "gpkg", "--all")
    meta, table, points = read_by_gdal(out / "signs.gpkg")
    assert meta["crs"] == "EPSG:4326"
    np.testing.assert_allclose(points, [[LON + 1e-4, LAT, ALT], [LON + 2e-4, LAT, ALT]], atol=1e-12)
    first, second = table.to_pylist()
    assert (first["color"], second["color"]) == ("red", None)
    assert (first["best_time_ns"], first["cov_yy"], first["measure"]) == (TIME_NS, 4.0, 12.35)
    with sqlite3.connect(out / "signs.gpkg") as content:
        words = dict(content.execute("select column_name, description from gpkg_data_columns"))
        (version,) = content.execute("pragma user_version").fetchone()
    content.close()
    assert version == 10200  # GDAL before 3.7 warns of later ones
    assert words["panel_width_m"] == "width of the face [m]"


def test_a_shapefile_shortens_names_and_keeps_times_whole(out, tmp_path):
    export(out, "-o", tmp_path / "signs.shp", "--all")
    meta, table, points = read_by_gdal(tmp_path / "signs.shp")
    row = table.to_pylist()[0]
    assert (row["best_tm_ns"], row["measur_unt"]) == (str(TIME_NS), "mi")
    assert row["pnl_wdth_m"] == pytest.approx(0.762)
    np.testing.assert_allclose(points[0], [LON + 1e-4, LAT, ALT], atol=1e-9)
    assert meta["crs"] == "EPSG:4326"


def test_a_kml_names_each_sign_and_leaves_it_on_the_ground(out, tmp_path):
    export(out, "-o", tmp_path / "signs.kml")
    text = (tmp_path / "signs.kml").read_text()
    assert "<name>d-0001</name>" in text
    assert "<description>red octagon</description>" in text
    assert "altitudeMode" not in text
    _, _, points = read_by_gdal(tmp_path / "signs.kml")
    np.testing.assert_allclose(points[:, :2], [[LON + 1e-4, LAT], [LON + 2e-4, LAT]], atol=1e-9)


def test_feet_and_inches_are_in_the_names_the_values_and_the_units(out, tmp_path):
    export(out, "-o", tmp_path / "us.csv", "--units", "us", "--all")
    row = read_csv(tmp_path / "us.csv")[0]
    found = [float(row[name]) for name in ("panel_width_in", "station_ft", "cov_yy_ft2")]
    assert found == pytest.approx([30, 1000, 4 / 0.3048**2], rel=1e-5)
    assert (row["facing_deg"], row["residual_px"], row["measure"]) == ("2.0", "0.5", "12.35")
    assert not [name for name in row if name.endswith("_m")]


def test_a_projection_is_that_of_proj_and_says_how_exact_it_is(out, tmp_path):
    words = export(out, "-o", tmp_path / "utm.gpkg", "--crs", UTM)
    assert "UTM zone 14N" in words
    assert "accuracy" in words
    meta, table, points = read_by_gdal(tmp_path / "utm.gpkg")
    assert meta["crs"] == UTM
    wanted = pyproj.Proj("+proj=utm +zone=14 +ellps=GRS80")(LON + 1e-4, LAT)
    np.testing.assert_allclose(points[0], [*wanted, ALT], atol=1e-3)
    row = table.to_pylist()[0]
    assert (row["crs"], row["crs_x"], row["crs_y"]) == (UTM, *points[0, :2].round(8))


@pytest.mark.parametrize(
    ("crs", "words"),
    [
        ("EPSG:4326", "coordinates in WGS 84, as they are"),
        ("WGS84", "coordinates in WGS 84, as they are"),
        ("EPSG:25832", "2 signs lie outside of the area that ETRS89 / UTM zone 32N is made"),
    ],
)
def test_the_system_of_the_signs_and_one_for_elsewhere_are_told(out, tmp_path, crs, words):
    assert words in export(out, "-o", tmp_path / "signs.gpkg", "--crs", crs)
    _, _, points = read_by_gdal(tmp_path / "signs.gpkg")
    same = np.allclose(points[0], [LON + 1e-4, LAT, ALT], atol=1e-9)
    assert same == words.startswith("coordinates")


def test_signs_without_fixes_lie_in_the_frame_of_the_drive(local, tmp_path):
    for name in ("signs.gpkg", "signs.shp"):
        assert "the log has no fixes" in export(local, "-o", tmp_path / name)
        meta, _, points = read_by_gdal(tmp_path / name)
        np.testing.assert_allclose(points, [[10, 3, 1.5], [20, 3, 1.5]])
        crs = pyproj.CRS(meta["crs"])
        assert (crs.type_name, crs.axis_info[0].unit_conversion_factor) == ("Engineering CRS", 1.0)
        assert "drive_start" in crs.name


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["-f", "kml"], "no satellite fixes"),
        (["-f", "geojson"], "Export CSV"),
        (["-f", "gpkg", "--crs", UTM], "Leave --crs out"),
        (["-f", "geojson", "--crs", UTM], "WGS 84 by its standard"),
        (["-f", "gpkg", "--crs", "EPSG:1"], "EPSG:26914"),
        (["-f", "gpkg", "--crs", "EPSG:5703"], "horizontal"),
        (["-f", "gpkg", "--crs", "EPSG:26914+5703"], "horizontal"),
        (["-f", "gpkg", "--crs", "EPSG:4979"], "horizontal"),
        (["-f", "mcap", "--units", "us"], "in metres"),
        (["-f", "csv", "--pictures"], "Choose gpkg or kmz"),
        (["-f", "shp", "-o", "signs.zip"], "must end with .shp"),
        (["-o", "signs.dwg"], ".gpkg"),
        ([], "Give -f"),
    ],
)
def test_what_does_not_go_together_is_refused_in_words(local, options, words):
    with pytest.raises(UsageError, match=words):
        export(local, *options)


def test_the_same_result_gives_the_same_bytes_and_another_file_is_kept(out, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))  # scratch files lie beside
    (tmp_path / "again").mkdir()
    for kind in ("gpkg", "fgb", "shp", "kml", "kmz", "xlsx"):
        for folder in (tmp_path, tmp_path, tmp_path / "again"):
            assert "2 rows" in export(out, "-o", folder / f"signs.{kind}")
        first, second = (tmp_path / f"signs.{kind}", tmp_path / "again" / f"signs.{kind}")
        assert first.read_bytes() == second.read_bytes()
    (tmp_path / "mine.dbf").write_text("mine")
    with pytest.raises(OutputError, match="--overwrite"):
        export(out, "-o", tmp_path / "mine.shp")
    assert sorted(path.name for path in tmp_path.glob("mine.*")) == ["mine.dbf"]
    export(out, "-o", tmp_path / "mine.shp", "--overwrite")
    assert len(read_by_gdal(tmp_path / "mine.shp")[1]) == 2


def test_missing_signs_and_cut_remarks_are_told(local, tmp_path):
    review = tmp_path / "review.csv"
    review.write_text(f"sign_id,review,x,y,note\n,missing,31.5,4,\nd-0001,accepted,,,{'x' * 300}\n")
    words = export(local, "-o", tmp_path / "signs.shp", "--review", review)
    assert "1 texts of review_note are cut" in words
    _, table, points = read_by_gdal(tmp_path / "signs.shp")
    assert table.column("review").to_pylist() == ["accepted", None, "missing"]
    assert points[2, :2].tolist() == [31.5, 4.0]


def test_without_the_package_the_way_to_install_it_is_told(out, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    with pytest.raises(UsageError, match=r"wayside\[gis\]"):
        export(out, "-f", "gpkg")
    assert not (out / "signs.gpkg").exists()


names = st.text("abcdefgh_", min_size=1, max_size=30)


@given(st.lists(names, unique=True, max_size=40))
def test_short_names_are_short_and_of_one_column_each(found):
    short = short_names([Column(name, pa.string(), "", "") for name in found])
    assert list(short) == found
    assert len(set(short.values())) == len(found)
    assert all(1 <= len(name) <= SHORT_NAME for name in short.values())


TOO_FEW = {"csv": 256, "geojson": 512, "gpkg": 4096, "shp": 1024, "kml": 1024}
"""Bytes that two rows do not fit in."""


@pytest.mark.parametrize("end", TOO_FEW)
def test_a_file_that_finds_no_room_is_not_written_and_the_earlier_one_stays(
    out, tmp_path, python, end
):
    file = tmp_path / f"signs.{end}"
    file.write_bytes(b"earlier")
    code = (
        "import resource, sys; from wayside.pipeline.cli import main; "
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({TOO_FEW[end]},) * 2); main()"
    )
    done = python(code, "export", out, "-o", file, "--overwrite", status=5)
    assert str(file) in done.stderr
    assert "Traceback" not in done.stderr
    left = {path.name: path.read_bytes() for path in tmp_path.glob("*signs*")}
    assert left == {file.name: b"earlier"}


@pytest.mark.parametrize("kept", [0.0, 0.4, 0.7, 0.95])
@pytest.mark.parametrize("suffix", [".gpkg", ".shp", ".dbf", ".shx", ".kml"])
def test_what_gdal_cuts_silently_is_seen_when_read_back(out, tmp_path, monkeypatch, suffix, kept):
    whole = pyogrio.write_arrow

    def cut(batches, path, **options):
        whole(batches, path, **options)
        part = path.with_suffix(suffix)
        part.write_bytes(part.read_bytes()[: int(kept * part.stat().st_size)])

    monkeypatch.setattr(pyogrio, "write_arrow", cut)
    end = suffix if suffix in (".gpkg", ".kml") else ".shp"
    with pytest.raises(OutputError, match="read back"):
        export(out, "-o", tmp_path / f"signs{end}")
    assert list(tmp_path.glob("*signs*")) == []


def test_of_files_that_belong_together_none_is_replaced_where_one_finds_no_room(
    out, tmp_path, monkeypatch
):
    export(out, "-o", tmp_path / "signs.shp")
    before = {path.name: path.read_bytes() for path in tmp_path.glob("signs.*")}
    copy, count = shutil.copyfileobj, itertools.count()

    def full(source, stream):
        if next(count) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        copy(source, stream)

    monkeypatch.setattr(shutil, "copyfileobj", full)
    with pytest.raises(OutputError, match="No space"):
        export(out, "-o", tmp_path / "signs.shp", "--overwrite", "--units", "us")
    assert {path.name: path.read_bytes() for path in tmp_path.glob("*signs.*")} == before
