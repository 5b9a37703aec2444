"""A run replaces its own earlier result, and nothing else unasked."""

import hashlib
import json

import pytest

from wayside.pipeline.files.output_folder import RECORDING
from wayside.pipeline.results.result import TABLES, check_earlier, log_fingerprint
from wayside.schemas.errors import OutputError

from .results import invoke


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "drive.mcap"
    path.write_bytes(b"a drive")
    return path


@pytest.fixture
def out(tmp_path, log):
    """A result of the log."""
    folder = tmp_path / "out"
    folder.mkdir()
    run = {"wayside": "0.1.0", "log": log.name, "log_path": str(log), "files": {}}
    run |= {"log_fingerprint": log_fingerprint(log), "recording": None}
    for name in TABLES:
        (folder / name).write_text(name)
        run["files"][name] = {"rows": 1, "sha256": hashlib.sha256(name.encode()).hexdigest()}
    (folder / "run.json").write_text(json.dumps(run))
    return folder


def test_an_empty_folder_or_none_is_free(tmp_path, log):
    assert not check_earlier(tmp_path / "none", log).recorded
    (tmp_path / "notes.txt").write_text("mine")
    assert not check_earlier(tmp_path, log).recorded


def test_a_result_of_the_same_log_is_replaced_wherever_that_lies_and_without_all_tables(out, log):
    check_earlier(out, log).check_recording()
    (out / TABLES[0]).unlink()
    check_earlier(out, log.rename(log.with_name("moved.mcap")))


def test_another_log_of_the_same_path_is_another_log(out, log):
    log.write_bytes(b"b drive")
    with pytest.raises(OutputError, match="--overwrite") as caught:
        check_earlier(out, log)
    assert f"the folder holds the result of {log} (of another log)" in str(caught.value)
    assert caught.value.exit_status == 5
    check_earlier(out, log, overwrite=True)


@pytest.mark.parametrize("name", TABLES)
def test_a_table_that_was_changed_since_is_kept(out, log, name):
    (out / name).write_text("mine")
    with pytest.raises(OutputError, match=f"holds {name} .not as its run.json states"):
        check_earlier(out, log)


@pytest.mark.parametrize("name", [*TABLES, "run.json"])
@pytest.mark.parametrize(
    "text", ['{"files": {}}', "[" * 100_000, '{"files":' * 100_000, "\0", "null"]
)
def test_files_of_the_names_of_a_result_that_are_none_are_kept(tmp_path, log, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(OutputError, match=f"holds {name} .not a result of wayside"):
        check_earlier(tmp_path, log)
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to(tmp_path / "none")
    with pytest.raises(OutputError, match="not a result"):
        check_earlier(tmp_path, log)


def test_a_recording_goes_with_its_result_and_another_one_stays(out, log):
    (out / RECORDING).write_text("mine")
    found = check_earlier(out, log)
    assert not found.recorded
    with pytest.raises(OutputError, match=RECORDING):
        found.check_recording()
    check_earlier(out, log, overwrite=True).check_recording()
    run = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(run | {"recording": RECORDING}))
    found = check_earlier(out, log)
    assert found.recorded
    found.check_recording()


def test_of_several_logs_all_places_are_looked_at_before_the_first_is_run(tmp_path):
    logs = [tmp_path / name for name in ("a.mcap", "b.mcap")]
    for log in logs:
        log.write_text("no log, which a run would say")
    (tmp_path / "out" / "b").mkdir(parents=True)
    (tmp_path / "out" / "b" / TABLES[0]).write_text("mine")
    with pytest.raises(OutputError, match="b: the result cannot be written"):
        invoke("run", *logs, "-o", tmp_path / "out")
    assert not (tmp_path / "out" / "a").exists()
