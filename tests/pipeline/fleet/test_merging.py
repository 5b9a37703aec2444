"""Results of drives to one inventory, and the changes between two surveys of it."""

import json
import re
import shutil
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import mercantile
import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest

from wayside.pipeline.cli import app
from wayside.pipeline.evidence.marks import US
from wayside.pipeline.exporting.export import export
from wayside.pipeline.files import output_folder
from wayside.pipeline.files.output_folder import DONE, OutputFolder
from wayside.pipeline.fleet.changes import find_changes, parse_survey, same_face
from wayside.pipeline.fleet.changes_page import write_page
from wayside.pipeline.fleet.folders import merge_settings_of
from wayside.pipeline.fleet.inventory_data import cells
from wayside.pipeline.fleet.manifest import Entry, Manifest, State, write_manifest
from wayside.pipeline.fleet.merging import MergeReport, merge_inventory
from wayside.pipeline.fleet.merging_rows import agreed_code
from wayside.pipeline.fleet.status import format_status
from wayside.pipeline.reviewing.matching import NO_REVIEW
from wayside.schemas.errors import InputError, OutputError, UsageError
from wayside.schemas.inventory_tables import PANELS, SIGHTINGS, SUPPORTS
from wayside.schemas.settings import ChangeSettings, MergeSettings

from .conftest import FINDS_ALL, drives_of, rewrite

PARTS = ("panels", "supports", "sightings")
SEEN = ["changes", "--before", "2024", "--after", "2025"]


def rows_of(inventory, table):
    return ds.dataset(inventory / table).to_table().to_pylist()


def read_changes(inventory, **more):
    return find_changes(inventory, parse_survey("2024"), parse_survey("2025"), **more)


def changed_rows(inventory):
    read_changes(inventory)
    return pq.read_table(inventory / "changes.parquet").to_pylist()


def done(*names):
    """A manifest of logs that are done."""
    return Manifest({name: Entry(name, name, name, 1, name, State.DONE) for name in names})


@dataclass(frozen=True)
class Surveyed:
    """An inventory of a road of 3 km seen twice in each of two years, and what became of its panels."""

    folder: Path
    report: MergeReport
    identities: dict[str, list[int]]
    history: dict[int, tuple[str, int | None]]

    def identity_of(self):
        """True panels by `panel_id`; -1: none."""
        result = {}
        for row in rows_of(self.folder, "sightings"):
            number = int(row["sign_id"].rsplit("-", 1)[1]) - 1
            result.setdefault(row["panel_id"], set()).add(self.identities[row["drive"]][number])
        return result


@pytest.fixture(scope="module")
def surveyed(simulation, drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("inventory")
    rng = np.random.default_rng(4)
    road = simulation.make_road(0, 3000.0, 30.0, rng)
    later, history = simulation.change_road(road, 0.2, rng)
    quality = {"misread": 0.0, "outliers": 0.0, "false": 0.0}
    identities = {}
    for year, one in enumerate((road, later)):
        for k in range(2):
            found = drive(folder, f"y{year}p{k}", one, rng, year=year, day=k, quality=quality)
            identities[f"y{year}p{k}"] = found.tolist()
    return Surveyed(folder, merge_inventory(drives_of(folder), folder), identities, history)


@pytest.fixture
def copied(surveyed, tmp_path):
    """A copy of the inventory, to be changed."""
    return shutil.copytree(surveyed.folder, tmp_path / "inventory")


NO_FIXES = dict.fromkeys(
    ("lon_deg", "lat_deg", "alt_m", "geometry", "sigma_east_m", "sigma_north_m", "sigma_alt_m")
)


@pytest.mark.parametrize("sense", [1, -1])
def test_drives_without_fixes_are_merged_and_compared_by_milepost(copied, surveyed, sense):
    """Each begins some metres off its milepost, and has a spacing that is up to half a percent off."""
    lateral = {}
    for number, folder in enumerate(drives_of(copied)):

        def along(row, off=number - 1.5):
            return {"station_m": row["station_m"] * (1 + 0.003 * off) + 3.0 * off}

        def sign(row, along=along):
            station = along(row)
            measure = 50.0 + sense * station["station_m"] / 1609.344
            lateral[row["sign_id"]] = sense * row["lateral_m"]
            told = {"route": "US-36", "measure": measure, "measure_unit": "mi"}
            return NO_FIXES | station | told | {"up_m": 2.0 - row["down_m"]}

        rewrite(folder / "signs.parquet", sign)
        rewrite(
            folder / "frames.parquet",
            lambda row, along=along: NO_FIXES | along(row) | {"heading_deg": None},
        )
        run = json.loads((folder / "run.json").read_text())
        route = {"name": "US-36", "milepost": 50.0, "unit": "mi", "decreasing": sense < 0}
        (folder / "run.json").write_text(json.dumps(run | {"settings": {"route": route}}))
    assert not merge_inventory(drives_of(copied), copied).local_drives
    true, found = (Counter(r["change"] for r in changed_rows(f)) for f in (surveyed.folder, copied))
    assert sum((true - found).values()) + sum((found - true).values()) <= 4
    assert found["gone"] > 5
    for row in rows_of(copied, "panels"):
        assert row["lon_deg"] is row["geometry"] is None
        assert row["lateral_m"] == pytest.approx(lateral[row["best_sign_id"]], abs=0.5)
        assert 0 <= sense * (row["measure"] - 50.0) < 3100 / 1609.344
    write_page(copied, copied / "page.html", ("2024", "2025"))
    assert (copied / "page.html").read_text().count("US-36, ") >= found["gone"]
    export(copied, NO_REVIEW, copied / "panels.csv", "csv")


def test_every_sighting_is_written_once_and_the_tables_tell_of_each_other(surveyed):
    panels, supports, sightings = (rows_of(surveyed.folder, part) for part in PARTS)
    counts = surveyed.report.panels, surveyed.report.supports, surveyed.report.sightings
    assert counts == (len(panels), len(supports), len(sightings))
    assert surveyed.report.left_out == 0
    read = sorted((row["drive"], row["sign_id"]) for row in sightings)
    assert read == [
        (folder.name, sign)
        for folder in drives_of(surveyed.folder)
        for sign in sorted(pq.read_table(folder / "signs.parquet")["sign_id"].to_pylist())
    ]
    for panel in panels:
        name = panel["panel_id"]
        own = sorted((s["seen"], s["drive"]) for s in sightings if s["panel_id"] == name)
        assert (panel["first_seen"], panel["last_seen"]) == (own[0][0], own[-1][0])
        assert panel["drives"] == [name for _, name in own]
        assert panel["times_seen"] == len(own)
    for support in supports:
        own = sorted(p["panel_id"] for p in panels if p["support_id"] == support["support_id"])
        told = support["panel_ids"], support["support_id"], support["panels"]
        assert told == (own, own[0], len(own))


def test_panels_are_merged_one_to_one_across_the_borders_of_cells(surveyed):
    assert surveyed.report.cells > 1
    of_panel = surveyed.identity_of()
    # from behind, another face at the same place cannot be told
    earlier = {new: old for old, (kind, new) in surveyed.history.items() if kind == "changed_face"}
    assert all(len({earlier.get(i, i) for i in found}) == 1 for found in of_panel.values())
    changed = earlier.keys() | earlier.values()
    doubled = Counter(one for found in of_panel.values() for one in found - changed)
    assert max(doubled.values()) == 1


def test_the_route_is_that_of_a_drive_that_knew_it_with_its_unit(copied):
    about = {"route": "A 8", "measure": 1.125, "measure_unit": "km"}
    rewrite(copied / "drives" / "y0p1" / "signs.parquet", lambda row: about)
    merge_inventory(drives_of(copied), copied)
    for table in ("panels", "supports"):
        rows = rows_of(copied, table)
        named = [row for row in rows if "y0p1" in row["drives"]]
        assert 0 < len(named) < len(rows)
        for row in rows:
            route = {name: row[name] for name in about}
            assert route == (about if row in named else dict.fromkeys(about))


def test_tables_lie_in_the_quadkey_of_their_cell_with_the_stated_columns(surveyed):
    for table in (PANELS, SUPPORTS, SIGHTINGS):
        files = sorted((surveyed.folder / table.name).rglob("*.parquet"))
        assert len(files) == surveyed.report.cells
        for file in files:
            assert pq.read_schema(file).remove_metadata().equals(table.schema.remove_metadata())
            assert b"geo" in pq.read_metadata(file).metadata
            tile = mercantile.quadkey_to_tile(file.parent.name.removeprefix("cell="))
            box = mercantile.bounds(tile)
            for lon in pq.read_table(file)["lon_deg"].to_pylist():
                assert box.west - 0.001 < lon < box.east + 0.001


def test_the_order_of_the_results_changes_no_byte(surveyed, tmp_path):
    merge_inventory(drives_of(surveyed.folder)[::-1], tmp_path)
    for part in PARTS:
        for file in sorted((tmp_path / part).rglob("*.parquet")):
            assert file.read_bytes() == (surveyed.folder / file.relative_to(tmp_path)).read_bytes()


def test_a_survey_of_another_base_station_doubles_and_moves_no_panel(simulation, drive, tmp_path):
    base = np.array([-4.0, 3.0, 45.0])
    rng = np.random.default_rng(6)
    road = simulation.make_road(0, 3000.0, 60.0, rng)
    exact = {"fix_sigma_m": 0.02} | FINDS_ALL
    for day, name in enumerate(("first", "again", "other")):
        drive(tmp_path, name, road, rng, year=min(day, 1), day=day, quality=exact)

    def moved(row):
        at = np.array([[row["lon_deg"], row["lat_deg"], row["alt_m"]]])
        there = road.origin.geodetic(road.origin.topocentric(at) + base)[0]
        return dict(zip(("lon_deg", "lat_deg", "alt_m"), there.tolist(), strict=True))

    for table in ("signs.parquet", "frames.parquet"):
        rewrite(tmp_path / "drives" / "other" / table, moved)
    report = merge_inventory(drives_of(tmp_path), tmp_path)
    (vector,) = report.vectors
    assert vector.startswith("other: all its panels differ from those of first by")
    assert vector in str(report)
    told = [float(number) for number in re.findall(r"[-+][0-9.]+", vector)]
    assert told == pytest.approx(base, abs=0.1)
    offset = [
        [row[f"offset_{axis}_m"] for axis in ("east", "north", "up")]
        for row in rows_of(tmp_path, "sightings")
        if row["drive"] == "other"
    ]
    assert np.mean(offset, axis=0) == pytest.approx(base, abs=0.15)
    assert set(read_changes(tmp_path).counts) == {"unchanged", "not_looked_at"}


def test_settings_decide_what_is_merged_and_are_recorded_in_every_part(surveyed, tmp_path):
    apart = MergeSettings(reach_m=0.1, support_m=0.0)
    report = merge_inventory(drives_of(surveyed.folder), tmp_path, apart)
    assert report.panels > 1.5 * surveyed.report.panels
    for part in tmp_path.glob("*/cell=*/part-0.parquet"):
        assert merge_settings_of(part) == apart
    assert merge_settings_of(next(surveyed.folder.glob("panels/*/*"))) == MergeSettings()


def test_the_settings_of_a_comparison_are_those_given_and_recorded_in_it(copied):
    arguments = [*SEEN, str(copied), "-o", str(copied / "page.html"), "--set", "changes.moved_m=0"]
    app(arguments, standalone_mode=False)
    table = pq.read_table(copied / "changes.parquet")
    assert "moved" not in table["change"].to_pylist()
    about = json.loads(table.schema.metadata[b"wayside"])
    assert about["settings"]["changes"] == asdict(ChangeSettings(moved_m=0.0))
    with pytest.raises(UsageError, match="Give settings of runs and merging to `wayside fleet`"):
        app([*arguments, "--set", "merge.support_m=1"], standalone_mode=False)


def test_cells_are_those_of_mercantile():
    points = np.random.default_rng(0).uniform([-180, -85, 0], [180, 85, 0], (200, 3))
    for (x, y), (lon, lat, _) in zip(cells(points, 14).tolist(), points, strict=True):
        tile = mercantile.tile(lon, lat, 14)
        assert (x, y) == (tile.x, tile.y)


def test_a_drive_without_fixes_is_told_and_its_signs_are_counted(surveyed, copied):
    columns = {"signs": ("lon_deg", "sigma_east_m"), "frames": ("lon_deg", "heading_deg")}
    for table, names in columns.items():
        file = copied / "drives" / "y0p0" / f"{table}.parquet"
        rewrite(file, lambda row, names=names: dict.fromkeys(names))
    report = merge_inventory(drives_of(copied), copied)
    assert report.local_drives == ["y0p0"]
    assert report.left_out == len(surveyed.identities["y0p0"])
    assert "without satellite fixes or a milepost: 1 drive: " in str(report)


def test_results_of_one_name_and_folders_of_the_user_are_refused(surveyed, tmp_path):
    one = drives_of(surveyed.folder)[0]
    with pytest.raises(UsageError, match="have the same name"):
        merge_inventory([one, one], tmp_path)
    (tmp_path / "panels").mkdir()
    (tmp_path / "panels" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="not a table of an inventory"):
        merge_inventory([one], tmp_path)
    assert (tmp_path / "panels" / "notes.txt").read_text() == "mine"


def read_export(inventory):
    assert export(inventory, NO_REVIEW, inventory / "panels.csv", "csv").rows > 0


def read_status(inventory):
    assert "panels: merged" in format_status(inventory)


def read_answer(inventory):
    query = pytest.importorskip("wayside.pipeline.fleet.query", exc_type=UsageError)
    assert query.first_rows(inventory, "FROM panels", 1)[1]


@pytest.mark.parametrize("read", [read_changes, read_export, read_status, read_answer])
def test_whoever_opens_an_inventory_completes_a_merging_that_was_killed(copied, read, monkeypatch):
    manifest = done(*(path.name for path in drives_of(copied)))
    write_manifest(copied, replace(manifest, merged=manifest.results()))
    monkeypatch.setattr(output_folder, "_PATIENCE_S", 0.1)
    with OutputFolder(copied):
        (copied / DONE).mkdir()
        (copied / "panels").rename(copied / DONE / "panels")
        (copied / DONE / ".files.json").write_text('[["panels"], []]')
        with pytest.raises(InputError, match="is replacing the result"):
            read(copied)
    assert (copied / DONE / "panels").is_dir()
    read(copied)
    assert (copied / "panels").is_dir()
    assert not (copied / DONE).exists()


def test_most_changes_between_two_surveys_are_found_for_what_they_are(surveyed):
    rows = changed_rows(surveyed.folder)
    of_panel = {name: next(iter(found)) for name, found in surveyed.identity_of().items()}
    right = []
    for row in rows:
        identity = of_panel[row["panel_before"] or row["panel_after"]]
        expected = surveyed.history.get(identity, (None,))[0]
        if row["change"] != "not_looked_at" and expected is not None:
            right.append(row["change"] == expected)
    assert len(right) > 90
    assert np.mean(right) > 0.93


def test_what_no_drive_of_the_other_survey_had_in_view_is_neither_gone_nor_new(
    simulation, drive, tmp_path
):
    rng = np.random.default_rng(7)
    road = simulation.make_road(0, 2000.0, 30.0, rng)
    drive(tmp_path, "first", road, rng)
    drive(tmp_path, "second", road.select(slice(0, 0)), rng, year=1, until_m=1000.0)
    merge_inventory(drives_of(tmp_path), tmp_path)
    rows = changed_rows(tmp_path)
    places = np.array([[row["lon_deg"], row["lat_deg"], row["alt_m"]] for row in rows])
    east = road.origin.topocentric(places)[:, 0].tolist()
    beyond = {row["change"] for row, x in zip(rows, east, strict=True) if x > 1050}
    inside = [
        row["change"]
        for row, x in zip(rows, east, strict=True)
        if 100 < x < 900 and row["color_before"] is not None  # seen from the front
    ]
    counts = Counter(row["change"] for row in rows)
    assert beyond == {"not_looked_at"}
    assert set(counts) == {"not_looked_at", "gone"}
    assert inside.count("gone") > 0.6 * len(inside)  # small faces do not show in three images
    assert {row["drive_after"] for row in rows if row["change"] == "gone"} == {"second"}
    write_page(tmp_path, tmp_path / "changes.html", ("2024", "2025"), every=True)
    text = (tmp_path / "changes.html").read_text()
    captions = re.findall(r"<figcaption>2025: (.*?)(?:, second.*)?</figcaption>", text)
    assert Counter(captions) == {
        "not looked at; not in view of any drive": counts["not_looked_at"],
        "no panel found; seen by 0 of 1 drive": counts["gone"],
    }


def test_what_one_drive_did_not_find_is_gone_less_surely_than_what_two_did_not(
    simulation, drive, tmp_path
):
    rng = np.random.default_rng(7)
    road = simulation.make_road(0, 1000.0, 30.0, rng)
    empty = road.select(slice(0, 0))

    def compared():
        merge_inventory(drives_of(tmp_path), tmp_path)
        return changed_rows(tmp_path)

    drive(tmp_path, "found", road, rng)
    told = []
    for looks in (1, 2):
        drive(tmp_path, f"later{looks}", empty, rng, year=1)
        rows = compared()
        gone = [row for row in rows if row["change"] == "gone"]
        told.append(max(row["probability"] for row in gone if row["drives_after"] == looks))
        assert {row["probability"] for row in rows if row["change"] == "not_looked_at"} == {None}
    assert told[0] < 0.5 < told[1] < 0.9
    drive(tmp_path, "missed", empty, rng)
    missed = [row for row in compared() if (row["seen_before"], row["drives_before"]) == (1, 2)]
    assert len(missed) > 0.5 * len(gone)
    assert max(row["probability"] or 0 for row in missed) < told[0]


CODED = {
    f"{code} {legend or ''}".strip(): {"mutcd": code, "legend": legend, "code_probability": 0.9}
    for code, legend in [("R2-1", "45"), ("R2-1", "35"), ("R1-1", None), ("R", None), ("W", None)]
}


@pytest.mark.parametrize(
    ("said", "agreed"),
    [
        (["R2-1 45", "R2-1 45", "R2-1 35"], ("R2-1", "45", "regulatory", 0.6)),
        (["R2-1 45", "R2-1 35"], ("R2-1", None, "regulatory", 0.9)),
        (["R2-1 45", "R1-1", "warning"], ("R", None, "regulatory", 0.6)),
        (["R", "R2-1 45", ""], ("R2-1", "45", "regulatory", 0.9)),
        (["R2-1 45", "W"], (None, None, None, None)),
        (["guide", ""], (None, None, "guide", None)),
    ],
)
def test_what_most_drives_say_of_a_code_is_kept_down_to_where_they_disagree(said, agreed):
    empty = dict.fromkeys(("mutcd", "vienna", "legend", "category", "code_probability"))
    found = agreed_code([empty | CODED.get(one, {"category": one or None}) for one in said])
    values = found["mutcd"], found["legend"], found["category"], found["code_probability"]
    assert values == (*agreed[:3], agreed[3] and pytest.approx(agreed[3]))


def test_another_number_on_the_same_face_is_a_change(simulation, drive, tmp_path):
    rng = np.random.default_rng(3)
    road = simulation.make_road(0, 1000.0, 60.0, rng)
    for year, limit in enumerate(("45", "35")):
        drive(tmp_path, f"y{year}", road, rng, year=year)
        sign = {"mutcd": "R2-1", "legend": limit, "category": "regulatory", "code_probability": 0.9}
        file = tmp_path / "drives" / f"y{year}" / "signs.parquet"
        rewrite(file, lambda row, sign=sign: sign if row["status"] == "sign" else {})
    merge_inventory(drives_of(tmp_path), tmp_path)
    changed = [row for row in changed_rows(tmp_path) if row["change"] == "changed_face"]
    assert len(changed) == 5  # all that both drives saw from the front
    for row in changed:
        assert (row["code_before"], row["code_after"]) == ("R2-1 45", "R2-1 35")
        assert (row["date_after"] - row["date_before"]).days in (364, 365, 366)
    panels = {row["panel_id"]: row for row in rows_of(tmp_path, "panels")}
    assert {panels[row["panel_after"]]["legend"] for row in changed} == {"35"}


def test_two_panels_look_alike_where_nothing_known_of_them_differs():
    panel = {"color": "red", "shape": "octagon", "bearing_deg": 90.0}
    panel |= {"panel_width_m": 0.75, "panel_height_m": 0.75}
    coded = panel | {"mutcd": "R2-1", "legend": "45"}
    for alike in ({}, {"color": None}):
        assert same_face(panel, panel | alike)
    for differing in ({"color": "blue"}, {"shape": "circle"}):
        assert not same_face(panel, panel | differing)
    for alike in ({"legend": None}, {"mutcd": "R", "legend": None}):
        assert same_face(coded, coded | alike)
    for differing in ({"legend": "35"}, {"mutcd": "W", "legend": None}):
        assert not same_face(coded, coded | differing)


def test_a_part_of_an_earlier_version_is_told(copied):
    part = next(copied.glob("panels/*/part-0.parquet"))
    pq.write_table(pq.ParquetFile(part).read().drop_columns(["measure_unit"]), part)
    with pytest.raises(InputError, match=r"no column measure_unit.*once more"):
        read_changes(copied)


def test_results_that_are_not_merged_yet_are_not_compared(copied):
    expected = read_changes(copied).counts
    merged = done(*(path.name for path in drives_of(copied)))
    (copied / "drives" / "begun").mkdir()  # a run that was killed
    assert read_changes(copied).counts == expected
    tried = Entry("begun", "begun", "begun", 1, "begun", State.QUARANTINED)
    merged = replace(merged.with_entries([tried]), merged=merged.results())
    write_manifest(copied, merged)
    assert read_changes(copied).counts == expected
    later = Entry("y1p1", "y1p1", "y1p1", 1, "another run", State.DONE)
    write_manifest(copied, merged.with_entries([later]))
    with pytest.raises(InputError, match="newer than the merged tables"):
        read_changes(copied)


@pytest.mark.parametrize("text", ["24", "2024-13", "2024-05..2024-03", "last year"])
def test_a_survey_that_is_no_time_is_refused_and_another_includes_its_last_day(text):
    with pytest.raises(UsageError, match=r"is not a survey|ends before it starts"):
        parse_survey(text)
    survey = parse_survey("2024-03..2024-12")
    assert 1_735_689_599 * 10**9 in survey
    assert 1_735_689_600 * 10**9 not in survey


def test_the_command_writes_the_page_and_says_which_images_no_log_gives(copied, capsys):
    page = copied / "changes.html"
    # the drives were simulated: there are no logs
    assert app([*SEEN, str(copied), "-o", str(page)], standalone_mode=False) == 4
    said = capsys.readouterr()
    assert "unchanged" in said.out
    assert "no log has them: " in said.err
    kinds = re.findall(r'<li class="(\w+)"', page.read_text())
    assert {"gone", "unchanged"} & set(kinds) == {"gone"}


@pytest.mark.parametrize("width", [390, 1280])
def test_the_page_begins_with_changes_hides_a_kind_and_asks_no_network_unless_a_basemap_is_chosen(
    copied, in_browser, width
):
    report = read_changes(copied)
    page = copied / "changes.html"
    write_page(copied, page, ("2024", "2025"), every=True)
    basemaps = re.findall(r'<option value="https:[^"]*"', page.read_text())
    assert page.read_text().replace('http-equiv="', "").count("http") == len(basemaps)
    shown = """
      const shown = () => [...document.querySelectorAll("li")].filter(li => li.offsetHeight).length;
      const seen = dot => dot.getBoundingClientRect().width > 0;
      const onMap = () => [...map.querySelectorAll("[data-for]")].filter(seen).length;
      const all = shown(), box = document.querySelector("#show-gone");
      box.focus(); box.click();
      return [document.activeElement.id, all, all - shown(), onMap(), map.querySelectorAll("image").length,
        document.documentElement.scrollWidth <= innerWidth];
    """
    kinds = re.findall(r'<li class="(\w+)"', page.read_text())
    assert kinds.index("gone") < kinds.index("unchanged")
    every, gone = sum(report.counts.values()), report.counts["gone"]
    assert in_browser(page, shown, width=width) == ["show-gone", every, gone, every - gone, 0, True]


def test_a_person_finds_a_change_by_its_code_confirms_it_and_goes_on_another_day(
    copied, in_browser, tmp_path
):
    read_changes(copied)
    rows = pq.read_table(copied / "changes.parquet").to_pylist()
    coded = next(row for row in rows if row["change"] == "gone")
    coded |= {"code_before": "R1-1", "route": "K-18", "measure": 7.25, "measure_unit": "mi"}
    schema = pq.read_schema(copied / "changes.parquet")
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), copied / "changes.parquet")
    page = copied / "changes.html"
    write_page(copied, page, ("2024", "2025"), units=US)
    find = """
      at("find").value = "r1-1 k-18";
      at("find").dispatchEvent(new Event("input", { bubbles: true }));
      const card = cards.find(one => !one.hidden), found = [cards.filter(one => !one.hidden).length, card.innerText];
    """
    confirm = """
      card.querySelector("[data-review=confirmed]").click();
      const note = card.querySelector(".say input");
      note.value = "knocked over";
      note.dispatchEvent(new Event("change", { bubbles: true }));
      const wide = document.documentElement.scrollWidth - innerWidth;
      return [...found, JSON.stringify({ reviews: rows() }), wide];
    """
    count, words, saved, wide = in_browser(page, find + confirm, profile=tmp_path / "profile")
    assert (count, wide <= 0) == (1, True)
    assert "gone: R1-1" in words
    assert "K-18, 7.250 mi" in words
    again = "await load(new File([JSON.stringify({ reviews: rows() })], 'r.json')); return rows().length;"
    assert in_browser(page, again, profile=tmp_path / "profile") == 1
    (tmp_path / "saved.json").write_text(saved)
    assert "1 confirmed" in str(read_changes(copied, reviews=[tmp_path / "saved.json"]))
    write_page(copied, page, ("2024", "2025"))
    (begun,) = in_browser(page, "return rows();")
    assert begun["panel_before"] == coded["panel_before"]
    assert (begun["review"], begun["note"]) == ("confirmed", "knocked over")


def test_a_denied_change_is_none_and_what_reviewers_contradict_or_is_gone_is_counted(copied):
    first, second, third, *_ = [r for r in changed_rows(copied) if r["change"] == "gone"]
    said = {"Ann": (first, "denied"), "Bob": (second, "confirmed"), "Cy": (second, "denied")}
    said["Dee"] = (third | {"panel_before": "none/none-0001"}, "confirmed")
    for reviewer, (row, review) in said.items():
        about = {name: row[name] for name in ("change", "panel_before", "panel_after")}
        about |= {"review": review, "reviewer": reviewer, "note": "seen"}
        (copied / f"changes.review.{reviewer}.json").write_text(json.dumps({"reviews": [about]}))
    counts = "reviews: 1 denied, 1 of changes that are not found, 1 on which reviewers disagree"
    assert str(read_changes(copied)).endswith(counts)
    rows = pq.read_table(copied / "changes.parquet").to_pylist()
    found = {r["panel_before"]: r for r in rows if r["change"] == "gone"}
    names = ("review", "final_change", "reviewer", "review_note")
    denied, disagreed = ([found[one["panel_before"]][n] for n in names] for one in (first, second))
    assert denied == ["denied", None, "Ann", "seen"]
    assert disagreed == [None, "gone", None, None]
    (copied / "bad.json").write_text("[]")
    with pytest.raises(InputError, match="not a review as the page of changes"):
        read_changes(copied, reviews=[copied / "bad.json"])
