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
from wayside.pipeline.exporting.export import export
from wayside.pipeline.files import output_folder
from wayside.pipeline.fleet.changes import find_changes, parse_survey
from wayside.pipeline.fleet.changes_page import write_page
from wayside.pipeline.fleet.folders import locked_inventory, merge_settings_of
from wayside.pipeline.fleet.inventory_data import cell_name, cells
from wayside.pipeline.fleet.manifest import DONE, QUARANTINED, Entry, Manifest, write_manifest
from wayside.pipeline.fleet.merging import MergeReport, merge_inventory
from wayside.pipeline.fleet.status import format_status
from wayside.pipeline.reviewing.review import NO_REVIEW
from wayside.schemas.errors import InputError, OutputError, UsageError
from wayside.schemas.inventory_tables import PANELS, SIGHTINGS, SUPPORTS
from wayside.schemas.settings import ChangeSettings, MergeSettings
from wayside.schemas.tables import FRAMES, SIGNS

PARTS = ("panels", "supports", "sightings")
FINDS_ALL = {"recall": 1.0, "outliers": 0.0, "false": 0.0, "misread": 0.0}


@dataclass(frozen=True)
class Surveyed:
    """An inventory of a road of 3 km seen twice in each of two years, and what became of its panels."""

    folder: Path
    report: MergeReport
    identities: dict[str, list[int]]
    history: dict[int, tuple[str, int | None]]

    def rows(self, table):
        return list(ds.dataset(self.folder / table).to_table().to_pylist())

    def identity_of(self):
        """True panels by `panel_id`; -1: none."""
        result = {}
        for row in self.rows("sightings"):
            number = int(row["sign_id"].rsplit("-", 1)[1]) - 1
            result.setdefault(row["panel_id"], set()).add(self.identities[row["drive"]][number])
        return result


def read_changes(inventory):
    return find_changes(inventory, parse_survey("2024"), parse_survey("2025"))


@pytest.fixture(scope="module")
def surveyed(simulation, tmp_path_factory):
    folder = tmp_path_factory.mktemp("inventory")
    rng = np.random.default_rng(4)
    road = simulation.make_road(0, 3000.0, 30.0, rng)
    later, history = simulation.change_road(road, 0.2, rng)
    quality = simulation.Quality(misread=0.0, outliers=0.0, false=0.0)
    identities = {}
    for year, one in enumerate((road, later)):
        for k in range(2):
            name = f"y{year}p{k}"
            start = simulation.START_NS + year * simulation.YEAR_NS + k * simulation.DAY_NS
            drive = simulation.write_drive(folder / "drives" / name, one, start, True, quality, rng)
            identities[name] = drive.tolist()
    report = merge_inventory(sorted((folder / "drives").iterdir()), folder)
    return Surveyed(folder, report, identities, history)


def test_every_sighting_is_written_once_and_the_report_counts_what_is_there(surveyed):
    read = Counter((row["drive"], row["sign_id"]) for row in surveyed.rows("sightings"))
    signs = {
        (drive.name, sign)
        for drive in (surveyed.folder / "drives").iterdir()
        for sign in pq.read_table(drive / SIGNS.file, columns=["sign_id"])["sign_id"].to_pylist()
    }
    assert set(read) == signs
    assert set(read.values()) == {1}
    counts = [len(surveyed.rows(part)) for part in PARTS]
    assert [surveyed.report.panels, surveyed.report.supports, surveyed.report.sightings] == counts
    assert surveyed.report.left_out == 0


def test_panels_are_merged_one_to_one_across_the_borders_of_cells(surveyed):
    assert surveyed.report.cells > 1
    of_panel = surveyed.identity_of()
    # from behind, another face at the same place cannot be told
    earlier = {new: old for old, (kind, new) in surveyed.history.items() if kind == "changed_face"}
    assert all(len({earlier.get(i, i) for i in found}) == 1 for found in of_panel.values())
    changed = earlier.keys() | earlier.values()
    doubled = Counter(one for found in of_panel.values() for one in found - changed)
    assert max(doubled.values()) == 1


def test_a_panel_says_when_how_often_and_by_which_drives_it_was_seen(surveyed):
    sightings = surveyed.rows("sightings")
    for panel in surveyed.rows("panels"):
        own = sorted(
            (s["seen"], s["drive"]) for s in sightings if s["panel_id"] == panel["panel_id"]
        )
        assert panel["first_seen"] == own[0][0]
        assert panel["last_seen"] == own[-1][0]
        assert panel["drives"] == [drive for _, drive in own]
        assert panel["times_seen"] == len(own)


def test_supports_list_their_panels_and_panels_their_support(surveyed):
    panels = surveyed.rows("panels")
    for support in surveyed.rows("supports"):
        own = sorted(p["panel_id"] for p in panels if p["support_id"] == support["support_id"])
        assert support["panel_ids"] == own
        assert support["support_id"] == own[0]
        assert support["panels"] == len(own)


def test_the_route_is_that_of_a_drive_that_knew_it_with_its_unit(surveyed, tmp_path):
    shutil.copytree(surveyed.folder / "drives", tmp_path / "drives")
    file = tmp_path / "drives" / "y0p1" / "signs.parquet"
    signs = pq.read_table(file)
    about = {
        "route": ["A 8"] * len(signs),
        "measure": np.arange(len(signs)) / 8,
        "measure_unit": ["km"] * len(signs),
    }
    for name, values in about.items():
        at, kind = signs.schema.get_field_index(name), signs.schema.field(name)
        signs = signs.set_column(at, kind, pa.array(values).cast(kind.type))
    pq.write_table(signs, file)
    merge_inventory(sorted((tmp_path / "drives").iterdir()), tmp_path)
    for table in ("panels", "supports"):
        rows = list(ds.dataset(tmp_path / table).to_table().to_pylist())
        named = [row for row in rows if "y0p1" in row["drives"]]
        assert 0 < len(named) < len(rows)
        for row in rows:
            told = (row["route"], row["measure_unit"], row["measure"] is not None)
            assert told == (("A 8", "km", True) if row in named else (None, None, False))


def test_tables_lie_in_the_quadkey_of_their_cell_with_the_stated_columns(surveyed):
    for table in (PANELS, SUPPORTS, SIGHTINGS):
        files = sorted((surveyed.folder / table.name).rglob("*.parquet"))
        assert len(files) == surveyed.report.cells
        for file in files:
            assert pq.read_schema(file).remove_metadata().equals(table.schema.remove_metadata())
            assert b"geo" in pq.read_metadata(file).metadata
            box = mercantile.bounds(
                mercantile.quadkey_to_tile(file.parent.name.removeprefix("cell="))
            )
            for lon in pq.read_table(file)["lon_deg"].to_pylist():
                assert box.west - 0.001 < lon < box.east + 0.001


def test_the_order_of_the_results_changes_no_byte(surveyed, tmp_path):
    drives = sorted((surveyed.folder / "drives").iterdir(), reverse=True)
    merge_inventory(drives, tmp_path)
    for part in PARTS:
        for file in sorted((tmp_path / part).rglob("*.parquet")):
            assert file.read_bytes() == (surveyed.folder / file.relative_to(tmp_path)).read_bytes()


def test_a_survey_of_another_base_station_doubles_and_moves_no_panel(simulation, tmp_path):
    base = np.array([-4.0, 3.0, 45.0])
    rng = np.random.default_rng(6)
    road = simulation.make_road(0, 3000.0, 60.0, rng)
    exact = simulation.Quality(0.02, **FINDS_ALL)
    drives = tmp_path / "drives"
    for year, name in enumerate(("first", "again", "other")):
        start = simulation.START_NS + min(year, 1) * simulation.YEAR_NS + year * simulation.DAY_NS
        simulation.write_drive(drives / name, road, start, True, exact, rng)
    for table in (SIGNS, FRAMES):
        rows = pq.read_table(drives / "other" / table.file).to_pylist()
        for row in rows:
            at = np.array([[row["lon_deg"], row["lat_deg"], row["alt_m"]]])
            moved = road.origin.geodetic(road.origin.topocentric(at) + base)[0]
            row |= dict(zip(("lon_deg", "lat_deg", "alt_m"), moved.tolist(), strict=True))
        pq.write_table(pa.Table.from_pylist(rows, table.schema), drives / "other" / table.file)
    results = sorted(drives.iterdir())
    report = merge_inventory(results, tmp_path)
    assert len(report.vectors) == 1
    told = [float(number) for number in re.findall(r"[-+][0-9.]+", report.vectors[0])]
    assert told == pytest.approx(base, abs=0.1)
    assert report.vectors[0].startswith("other: all its panels differ from those of first by")
    assert report.vectors[0] in str(report)
    rows = ds.dataset(tmp_path / "sightings").to_table().to_pylist()
    offset = [
        [r[f"offset_{a}_m"] for a in ("east", "north", "up")] for r in rows if r["drive"] == "other"
    ]
    assert np.mean(offset, axis=0) == pytest.approx(base, abs=0.15)
    changed = read_changes(tmp_path).counts
    assert set(changed) == {"unchanged", "not_looked_at"}
    before = {file: file.read_bytes() for file in tmp_path.glob("*/cell=*/*")}
    merge_inventory(results[::-1], tmp_path)
    assert before == {file: file.read_bytes() for file in tmp_path.glob("*/cell=*/*")}


def test_settings_decide_what_is_merged_and_are_recorded_in_every_part(surveyed, tmp_path):
    drives = sorted((surveyed.folder / "drives").iterdir())
    apart = MergeSettings(reach_m=0.1, support_m=0.0)
    report = merge_inventory(drives, tmp_path, apart)
    assert report.panels > 1.5 * surveyed.report.panels
    for part in tmp_path.glob("*/cell=*/part-0.parquet"):
        assert merge_settings_of(part) == apart
    assert merge_settings_of(next(surveyed.folder.glob("panels/*/*"))) == MergeSettings()


def test_the_settings_of_a_comparison_are_those_given_and_recorded_in_it(surveyed, tmp_path):
    arguments = ["changes", str(surveyed.folder), "--before", "2024", "--after", "2025"]
    arguments += ["-o", str(tmp_path / "changes.html"), "--set", "changes.moved_m=0"]
    app(arguments, standalone_mode=False)
    table = pq.read_table(surveyed.folder / "changes.parquet")
    assert "moved" not in table["change"].to_pylist()
    about = json.loads(table.schema.metadata[b"wayside"])
    assert about["settings"]["changes"] == asdict(ChangeSettings(moved_m=0.0))
    with pytest.raises(UsageError, match="give their settings to `wayside fleet`"):
        app([*arguments, "--set", "merge.support_m=1"], standalone_mode=False)


def test_cells_are_those_of_mercantile():
    points = np.random.default_rng(0).uniform([-180, -85, 0], [180, 85, 0], (200, 3))
    for (x, y), (lon, lat, _) in zip(cells(points, 14).tolist(), points, strict=True):
        tile = mercantile.tile(lon, lat, 14)
        assert (x, y) == (tile.x, tile.y)
        assert cell_name(x, y, 14) == mercantile.quadkey(tile)


def test_a_drive_without_fixes_is_told_and_its_signs_are_counted(surveyed, tmp_path):
    drives = sorted((surveyed.folder / "drives").iterdir())
    local = tmp_path / "local"
    shutil.copytree(drives[0], local)
    for table, names in (
        (SIGNS, ("lon_deg", "sigma_east_m")),
        (FRAMES, ("lon_deg", "heading_deg")),
    ):
        rows = pq.read_table(local / table.file).to_pylist()
        for row in rows:
            row.update(dict.fromkeys(names))
        pq.write_table(
            pq.read_table(local / table.file).from_pylist(rows, table.schema), local / table.file
        )
    report = merge_inventory([*drives[1:3], local], tmp_path / "inventory")
    assert report.local_drives == ["local"]
    assert report.left_out == len(surveyed.identities["y0p0"])
    assert "1 drives have no satellite fixes" in str(report)


def test_two_results_of_one_name_are_refused(surveyed, tmp_path):
    drive = surveyed.folder / "drives" / "y0p0"
    with pytest.raises(UsageError, match="have the same name"):
        merge_inventory([drive, drive], tmp_path)


def test_a_folder_of_the_users_is_not_replaced(surveyed, tmp_path):
    (tmp_path / "panels").mkdir()
    (tmp_path / "panels" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="not a table of an inventory"):
        merge_inventory([surveyed.folder / "drives" / "y0p0"], tmp_path)
    assert (tmp_path / "panels" / "notes.txt").read_text() == "mine"


def read_export(inventory):
    assert export(inventory, NO_REVIEW, inventory / "panels.csv", "csv").rows > 0


def read_status(inventory):
    assert "panels: merged" in format_status(inventory)


def read_answer(inventory):
    query = pytest.importorskip("wayside.pipeline.fleet.query", exc_type=UsageError)
    assert query.first_rows(inventory, "FROM panels", 1)[1]


READERS = [read_changes, read_export, read_status, read_answer]


@pytest.fixture
def half_moved(surveyed, tmp_path):
    """An inventory whose merging was killed when `panels` was not in its place yet."""
    folder = shutil.copytree(surveyed.folder, tmp_path / "inventory")
    names = [path.name for path in (folder / "drives").iterdir()]
    manifest = Manifest({name: Entry(name, name, name, 1, name, DONE) for name in names})
    write_manifest(folder, replace(manifest, merged=manifest.results()))
    (folder / ".wayside-merge-done").mkdir()
    (folder / "panels").rename(folder / ".wayside-merge-done" / "panels")
    return folder


@pytest.mark.parametrize("read", READERS)
def test_whoever_opens_an_inventory_completes_a_merging_that_was_killed(half_moved, read):
    read(half_moved)
    assert (half_moved / "panels").is_dir()
    assert not (half_moved / ".wayside-merge-done").exists()


@pytest.mark.parametrize("read", READERS)
def test_nobody_completes_it_while_another_process_holds_the_lock(half_moved, read, monkeypatch):
    monkeypatch.setattr(output_folder, "_PATIENCE_S", 0.1)
    with locked_inventory(half_moved), pytest.raises(InputError, match="is replacing the result"):
        read(half_moved)
    assert (half_moved / ".wayside-merge-done" / "panels").is_dir()
    read(half_moved)


def test_most_changes_between_two_surveys_are_found_for_what_they_are(surveyed):
    report = read_changes(surveyed.folder)
    rows = pq.read_table(surveyed.folder / "changes.parquet").to_pylist()
    assert Counter(row["change"] for row in rows) == report.counts
    of_panel = {name: next(iter(found)) for name, found in surveyed.identity_of().items()}
    right = total = 0
    for row in rows:
        identity = of_panel[row["panel_before"] or row["panel_after"]]
        expected = surveyed.history[identity][0] if identity in surveyed.history else None
        if row["change"] != "not_looked_at" and expected is not None:
            right, total = right + (row["change"] == expected), total + 1
    assert total > 90
    assert right / total > 0.93


def test_what_no_drive_of_the_other_survey_had_in_view_is_neither_gone_nor_new(
    simulation, tmp_path
):
    rng = np.random.default_rng(7)
    road = simulation.make_road(0, 2000.0, 30.0, rng)
    quality = simulation.Quality(**FINDS_ALL)
    empty = road.select(slice(0, 0))
    end = {"until_m": 1000.0}
    simulation.write_drive(
        tmp_path / "drives" / "first", road, simulation.START_NS, True, quality, rng
    )
    later = simulation.START_NS + simulation.YEAR_NS
    simulation.write_drive(tmp_path / "drives" / "second", empty, later, True, quality, rng, **end)
    merge_inventory(sorted((tmp_path / "drives").iterdir()), tmp_path)
    report = read_changes(tmp_path)
    rows = pq.read_table(tmp_path / "changes.parquet").to_pylist()
    east = road.origin.topocentric(
        np.array([[r["lon_deg"], r["lat_deg"], r["alt_m"]] for r in rows])
    )[:, 0]
    beyond = {row["change"] for row, x in zip(rows, east.tolist(), strict=True) if x > 1050}
    inside = [
        row
        for row, x in zip(rows, east.tolist(), strict=True)
        if 100 < x < 900 and row["color_before"] is not None  # seen from the front
    ]
    gone = [row for row in inside if row["change"] == "gone"]
    assert beyond == {"not_looked_at"}
    assert {row["change"] for row in rows} == {"not_looked_at", "gone"}
    assert len(gone) > 0.6 * len(inside)  # small faces do not show in three images
    assert {row["drive_after"] for row in gone} == {"second"}
    write_page(tmp_path, tmp_path / "changes.html", ("2024", "2025"), every=True)
    text = (tmp_path / "changes.html").read_text()
    captions = re.findall(r"<figcaption>2025: (.*?)(?:, second.*)?</figcaption>", text)
    assert Counter(captions) == {
        "not looked at; not in view of any drive": report.counts["not_looked_at"],
        "no panel found; seen by 0 of 1 drives": report.counts["gone"],
    }


def test_what_one_drive_did_not_find_is_gone_less_surely_than_what_two_did_not(
    simulation, tmp_path
):
    rng = np.random.default_rng(7)
    road = simulation.make_road(0, 1000.0, 30.0, rng)
    quality = simulation.Quality(**FINDS_ALL)
    empty = road.select(slice(0, 0))
    later = simulation.START_NS + simulation.YEAR_NS
    told = []
    for looks in (1, 2):
        folder = tmp_path / str(looks)
        start = simulation.START_NS
        simulation.write_drive(folder / "drives" / "found", road, start, True, quality, rng)
        for k in range(looks):
            name = folder / "drives" / f"later{k}"
            simulation.write_drive(name, empty, later, True, quality, rng)
        merge_inventory(sorted((folder / "drives").iterdir()), folder)
        read_changes(folder)
        rows = pq.read_table(folder / "changes.parquet").to_pylist()
        gone = [row for row in rows if row["change"] == "gone"]
        told.append(max(row["probability"] for row in gone if row["drives_after"] == looks))
        assert {row["probability"] for row in rows if row["change"] == "not_looked_at"} == {None}
    assert told[0] < 0.5 < told[1] < 0.9
    simulation.write_drive(folder / "drives" / "missed", empty, start, True, quality, rng)
    merge_inventory(sorted((folder / "drives").iterdir()), folder)
    read_changes(folder)
    rows = pq.read_table(folder / "changes.parquet").to_pylist()
    missed = [row for row in rows if (row["seen_before"], row["drives_before"]) == (1, 2)]
    assert len(missed) > 0.5 * len(gone)
    assert max(row["probability"] or 0 for row in missed) < told[0]


def test_a_part_of_an_earlier_version_is_told(surveyed, tmp_path):
    folder = shutil.copytree(surveyed.folder, tmp_path / "inventory")
    part = next(folder.glob("panels/*/part-0.parquet"))
    pq.write_table(pq.ParquetFile(part).read().drop_columns(["measure_unit"]), part)
    with pytest.raises(InputError, match=r"no column measure_unit.*once more"):
        read_changes(folder)


def test_results_that_are_not_merged_yet_are_not_compared(surveyed, tmp_path):
    folder = shutil.copytree(surveyed.folder, tmp_path / "inventory")
    (folder / "drives" / "begun").mkdir()  # a run that was killed
    expected = read_changes(folder).counts
    names = [path.name for path in (folder / "drives").iterdir() if path.name != "begun"]
    entries = {name: Entry(name, name, name, 1, name, DONE) for name in names}
    tried = Entry("begun", "begun", "begun", 1, "begun", QUARANTINED)
    merged = Manifest(entries | {"begun": tried})
    merged = replace(merged, merged=merged.results())
    write_manifest(folder, merged)
    assert read_changes(folder).counts == expected
    later = Entry("y1p1", "y1p1", "y1p1", 1, "another run", DONE)
    write_manifest(folder, merged.with_entries([later]))
    with pytest.raises(InputError, match="newer than the merged tables"):
        read_changes(folder)


@pytest.mark.parametrize("text", ["24", "2024-13", "2024-05..2024-03", "last year"])
def test_a_survey_that_is_no_time_is_refused(text):
    with pytest.raises(UsageError, match=r"is not a survey|ends before it starts"):
        parse_survey(text)


def test_a_survey_includes_its_last_day():
    survey = parse_survey("2024-03..2024-12")
    assert 1_735_689_599 * 10**9 in survey
    assert 1_735_689_600 * 10**9 not in survey


def test_the_command_writes_the_page_and_says_which_images_no_log_gives(surveyed, tmp_path, capsys):
    page = tmp_path / "changes.html"
    arguments = ["changes", str(surveyed.folder), "--before", "2024", "--after", "2025"]
    # the drives were simulated: there are no logs
    assert app([*arguments, "-o", str(page)], standalone_mode=False) == 4
    said = capsys.readouterr()
    assert "unchanged" in said.out
    assert "images are not on the page" in said.err
    text = page.read_text()
    assert '<li class="gone">' in text
    assert '<li class="unchanged">' not in text


def test_the_page_hides_a_kind_of_change_and_needs_no_network(surveyed, tmp_path, in_browser):
    report = read_changes(surveyed.folder)
    page = tmp_path / "changes.html"
    write_page(surveyed.folder, page, ("2024", "2025"))
    assert "http" not in page.read_text().replace('http-equiv="', "")
    shown = """
      const shown = () => [...document.querySelectorAll("li")].filter(li => li.offsetHeight).length;
      const all = shown(), box = document.querySelector("#show-gone");
      box.focus(); box.click();
      return [document.activeElement.id, all, all - shown(), document.documentElement.scrollWidth <= innerWidth];
    """
    kinds = [kind for kind in report.counts if kind not in ("unchanged", "not_looked_at")]
    expected = ["show-gone", sum(report.counts[k] for k in kinds), report.counts["gone"], True]
    assert in_browser(page, shown) == expected
