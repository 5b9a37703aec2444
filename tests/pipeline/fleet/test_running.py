"""The results of the logs of a fleet, by what happens to their workers."""

import json
import shutil
from dataclasses import replace

import pytest

from wayside.pipeline.cli.fleet import read_log_table
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.fleet.folders import locked_inventory
from wayside.pipeline.fleet.manifest import Entry, Manifest, read_manifest, write_manifest
from wayside.pipeline.fleet.status import describe_duration, describe_progress, format_status
from wayside.schemas.errors import InputError, InterruptionError, OutputError, UsageError

from ..results import invoke
from .conftest import Died, InProcess

DONE = ("done", 0)


@pytest.mark.parametrize("name", ["../../outside", "/outside", "", "..", ".x", "a/b", "x" * 300])
def test_a_manifest_whose_log_is_no_folder_of_the_inventory_is_refused(fleet, tmp_path, name):
    seen = fleet({"a": "one"})
    entry = replace(read_manifest(seen.inventory).logs["a"], name=name, state="waiting")
    write_manifest(seen.inventory, Manifest({name: entry}))
    before = sorted(tmp_path.rglob("*"))
    for read in (fleet, lambda _: format_status(seen.inventory)):
        with pytest.raises(InputError, match="no name of a folder"):
            read({})
    assert sorted(tmp_path.rglob("*")) == before


def test_every_log_is_done_although_a_worker_dies(fleet, tmp_path):
    seen = fleet({"a": "one", "b": "die then two", "c": "three"})
    assert seen.states == {"a": DONE, "b": DONE, "c": DONE}
    assert sorted(seen.began) == ["a", "b", "b", "c"]
    assert seen.merged == [["a", "b", "c"]]
    assert read_manifest(seen.inventory).logs["b"].attempts == 2
    assert "SIGKILL" in (seen.inventory / "logs" / "b.txt").read_text()
    long = tmp_path / "logs" / ("x" * 252)  # a log like others
    long.write_text("four")
    assert list(fleet({}, given=[str(long)]).states.values()) == [DONE]


def test_a_table_gives_each_log_its_own_options_and_a_change_runs_that_log_alone(fleet, tmp_path):
    fleet({"a": "one", "b": "two"})
    table, camera = tmp_path / "logs.csv", tmp_path / "camera.yaml"
    row = f"{tmp_path}/logs/{{}}.mcap;{{}};8m"
    rows = ["log;route;milepost;decreasing;calibration;spacing"]
    rows += [row.format("a", f"US-36;12.5;;{camera}"), row.format("b", "K-7;3km;yes;")]
    table.write_text("\n".join(rows))
    seen = fleet({}, own=read_log_table(table, {"spacing": "9m"}))
    assert sorted(seen.began) == ["a", "b"]
    a, b = seen.settings["a"], seen.settings["b"]
    assert (a.route.name, a.route.milepost, a.route.decreasing) == ("US-36", 12.5, False)
    route = b.route.name, b.route.milepost, b.route.unit, b.route.decreasing
    assert route == ("K-7", 3, "km", True)
    assert (a.read.calibration, b.read.calibration, a.read.spacing_m) == (str(camera), "", 8.0)
    table.write_text(table.read_text().replace("3km", "4km"))
    assert fleet({}, own=read_log_table(table, {})).began == ["b"]
    table.write_text("log,speed\na.mcap,3\n")
    with pytest.raises(UsageError, match=r"has a column speed\. Its columns are log"):
        invoke("fleet", table, "-o", tmp_path / "other")


@pytest.mark.parametrize(("content", "logged"), [("die", " begun "), ("fault", "StageError")])
def test_a_log_that_always_fails_is_put_aside_with_its_log_until_a_retry(fleet, content, logged):
    seen = fleet({"a": content, "b": f"{content} then two"})
    assert seen.states == {"a": ("quarantined", 1), "b": DONE}
    assert (seen.began.count("a"), seen.began.count("b")) == (3, 2)
    assert seen.merged == [["b"]]
    folder = seen.inventory / "quarantine" / "a"
    assert (folder / "log.txt").read_text().count(logged) == 3
    assert "attempts: 3" in (folder / "error.txt").read_text()
    assert not (seen.inventory / "logs" / "a.txt").exists()
    assert fleet({}).began == []  # still in quarantine
    assert fleet({}, retry=True, attempts=2).began == ["a", "a"]


def test_a_log_that_cannot_be_used_is_not_tried_again_until_it_changes(fleet):
    seen = fleet({"a": "input", "b": "two"})
    assert seen.states["a"] == ("quarantined", 3)
    assert seen.began.count("a") == 1
    assert fleet({}).states["a"] == ("quarantined", 3)
    assert seen.began == []
    assert fleet({"a": "one"}, overwrite=True).states["a"] == DONE
    assert not (seen.inventory / "quarantine" / "a").exists()


def test_deaths_are_counted_that_only_the_log_itself_tells_of(fleet):
    class Rescheduling(InProcess):
        """Gives the task of a dead worker to the next one and says nothing, as Dask does."""

        def submit(self, given):
            while isinstance((future := super().submit(given)).exception(), Died):
                pass
            return future

        def result(self, future):
            return future.result()

    seen = fleet({"a": "die"}, engine=Rescheduling)
    assert seen.states == {"a": ("quarantined", 1)}
    assert seen.began == ["a"] * 3


def test_finished_logs_are_not_run_again_until_something_changes(fleet):
    seen = fleet({"a": "one", "b": "lost"})
    assert seen.states == {"a": DONE, "b": ("done", 4)}
    seen = fleet({})
    assert seen.began == seen.merged == []
    assert seen.report.kept == {"a", "b"}
    assert seen.states == {"a": DONE, "b": ("done", 4)}
    other, _ = load_settings(options={"read.every": 2})
    assert sorted(fleet({}, other).began) == ["a", "b"]
    (seen.inventory / "drives" / "a" / "signs.parquet").unlink()
    assert fleet({}, other).began == ["a"]
    (seen.inventory / "fleet.json").unlink()  # results count without it
    assert fleet({}, other).began == []
    for again in (["a", "b"], []):
        assert sorted(fleet({}, other, self_calibrate=True).began) == again
    assert read_manifest(seen.inventory).logs["a"].images == 8


def test_other_settings_of_merging_and_lost_tables_merge_anew_and_run_no_log_again(fleet):
    fleet({"a": "one"})
    other, _ = load_settings(assignments=["merge.support_m=0.9"])
    seen = fleet({}, settings=other)
    assert (seen.began, seen.merged) == ([], [["a"]])
    assert seen.merge_settings.support_m == 0.9
    assert fleet({}, settings=other).merged == []
    (seen.inventory / "panels").rmdir()
    assert "panels: not merged yet" in format_status(seen.inventory)
    assert fleet({}, settings=other).merged == [["a"]]


def test_logs_are_added_once_and_all_of_the_inventory_are_merged(fleet, tmp_path):
    seen = fleet({"a": "one", "b": "one"})
    assert (list(seen.states), [name for _, name in seen.report.copies]) == (["a"], ["a"])
    (tmp_path / "later").mkdir()
    shutil.copy(tmp_path / "logs" / "a.mcap", tmp_path / "later" / "copy.mcap")
    (tmp_path / "later" / "a.mcap").write_text("another of that name")
    seen = fleet({}, given=[str(tmp_path / "later")])
    assert seen.states == {"later_a": DONE, "a": DONE}
    assert seen.began == ["a"]  # the copy is the recording of before
    assert seen.merged == [["a", "later_a"]]


def test_a_log_leaves_the_inventory_with_its_result(fleet, tmp_path):
    seen = fleet({"a": "one", "b": "two"})
    shutil.rmtree(seen.inventory / "drives" / "a")
    (tmp_path / "logs" / "a.mcap").unlink()
    seen = fleet({})
    assert seen.report.left == ("a",)
    assert seen.merged == [["b"]]
    assert list(read_manifest(seen.inventory).logs) == ["b"]
    shutil.rmtree(seen.inventory / "drives" / "b")
    seen = fleet({})  # this one is given still
    assert (seen.began, seen.report.left) == (["b"], ())


def test_changed_content_is_refused_before_anything_is_run(fleet):
    fleet({"a": "one", "b": "two"})
    with pytest.raises(OutputError, match="have changed"):
        fleet({"a": "changed", "c": "three"})
    assert fleet({}, overwrite=True).began == ["a", "c"]


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [("full then one", OutputError, "full"), ("ctrl-c then one", InterruptionError, "1 of 2")],
)
def test_what_ends_the_fleet_is_no_attempt_and_the_same_command_goes_on(
    fleet, tmp_path, content, error, words
):
    with pytest.raises(error, match=words):
        fleet({"a": "two", "b": content})
    entry = read_manifest(tmp_path / "inventory").logs["b"]
    assert (entry.state, entry.attempts) == ("waiting", 0)
    seen = fleet({}, attempts=1)
    assert seen.states == {"a": DONE, "b": DONE}
    assert seen.began == ["b"]


def test_a_log_that_is_not_there_is_told_and_the_others_are_done(fleet, tmp_path):
    seen = fleet({"a": "one"}, given=[str(tmp_path / "none.mcap"), str(tmp_path / "logs")])
    assert seen.states == {"a": DONE, "none": ("quarantined", 3)}
    (tmp_path / "none.mcap").write_text("now")
    assert fleet({}, given=[str(tmp_path / "none.mcap")]).states == {"none": DONE}


def test_status_says_what_each_log_and_the_fleet_is_at(fleet, tmp_path):
    seen_inventory = tmp_path / "inventory"
    with locked_inventory(seen_inventory):
        assert "is checking its logs" in format_status(seen_inventory)
        with pytest.raises(OutputError, match="another fleet"):
            fleet({"a": "input", "b": "two"})
    fleet({})
    told = format_status(seen_inventory)
    assert "1 of 2 logs done, 1 in quarantine" in told
    assert "a: exit status 3, attempts 1: no images" in told
    assert "panels: merged" in told
    manifest = read_manifest(seen_inventory)
    write_manifest(seen_inventory, replace(manifest, merged=""))
    assert "panels: not merged yet" in format_status(seen_inventory)
    with locked_inventory(seen_inventory):
        told = format_status(seen_inventory)
        assert "a fleet has been running since" in told
        assert "panels: being merged now" in told
    again = replace(manifest.logs["b"], key="of another run")
    write_manifest(seen_inventory, manifest.with_entries([again]))
    assert "panels: out of date, not merged again yet" in format_status(seen_inventory)
    with pytest.raises(InputError, match="not an inventory"):
        format_status(tmp_path)
    (seen_inventory / "fleet.json").write_text(json.dumps({"logs": {"a": 1}}))
    with pytest.raises(InputError, match="cannot be read"):
        format_status(seen_inventory)


def test_time_left_is_by_bytes_at_the_rate_of_this_fleet():
    def entry(name, size, state, since):
        return Entry(name, name, name, size, "k", state, images=10, since=since)

    logs = [entry("before", 900, "done", 5.0), entry("a", 100, "done", 150.0)]
    logs += [entry("b", 300, "running", 150.0), entry("c", 100, "waiting", 100.0)]
    manifest = Manifest({e.name: e for e in logs}, started=100.0)
    told = describe_progress(manifest, now=150.0)
    assert told == "2 of 4 logs done, 0.2 images/s, about 3 min left"
    none = manifest.with_entries([entry("a", 100, "waiting", 100)])
    assert describe_progress(none, now=150.0) == "1 of 4 logs done"


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "1 s"), (89, "89 s"), (720, "12 min"), (12000, "3 h 20 min"), (187200, "2 days 4 h")],
)
def test_durations_are_told_in_two_units_at_most(seconds, words):
    assert describe_duration(seconds) == words
