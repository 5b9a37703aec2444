"""Several logs in one command: the result of each, and the exit status."""

import json

import pytest
import typer

from wayside.pipeline.cli import running
from wayside.pipeline.cli.running import RunOptions, process_all
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models import model_files
from wayside.pipeline.results.result import file_digest, log_fingerprint
from wayside.pipeline.running.journal import result_key
from wayside.schemas.errors import InputError, InterruptionError, OutputError, UsageError

from .results import NO_MODELS

SETTINGS, _ = load_settings()


@pytest.fixture
def drives(tmp_path, monkeypatch):
    """Runs logs whose content names their result: a status, or an error."""
    errors = {"input": InputError, "output": OutputError, "ctrl-c": InterruptionError}
    ran = []

    def process(log, folder, settings, viewing, how):
        ran.append(log.name)
        content = log.read_text() if log.exists() else "input"
        if content in errors:
            raise errors[content](f"{log}: made up")
        folder.mkdir(parents=True, exist_ok=True)
        table = folder / "signs.parquet"
        table.write_text(content)
        asked = {"every_region": how.every_region, "self_calibrate": how.self_calibrate}
        key = result_key(log, settings, NO_MODELS.digests(), **asked)
        files = {"signs.parquet": {"sha256": file_digest(table)}}
        about = {"wayside": "1", "log_fingerprint": log_fingerprint(log), "files": files}
        (folder / "run.json").write_text(json.dumps(about | {"result_key": key}))
        return int(content)

    monkeypatch.setattr(running, "process", process)
    monkeypatch.setattr(model_files, "load_models", lambda settings: NO_MODELS)

    def run(contents, settings=SETTINGS, **options):
        ran.clear()
        logs = [tmp_path / f"{name}.mcap" for name in contents]
        for log, content in zip(logs, contents.values(), strict=True):
            log.write_text(content)
        folders = [tmp_path / "out" / log.stem for log in logs]
        try:
            process_all(logs, folders, settings, None, RunOptions(**options))
        except typer.Exit as end:
            return end.exit_code, list(ran)
        return 0, list(ran)

    return run


def test_a_log_that_cannot_be_used_is_told_and_the_others_are_done(drives, capsys):
    assert drives({"a": "0", "b": "input", "c": "0"}) == (3, ["a.mcap", "b.mcap", "c.mcap"])
    said = capsys.readouterr()
    assert "b.mcap: made up" in said.err
    lines = said.out.split("\n\n")[-1].splitlines()
    ends = [line.rpartition(": ")[2].split(" in ")[0] for line in lines]
    assert ends == ["done, result", "failed, exit status 3", "done, result"]


@pytest.mark.parametrize(
    ("contents", "status"),
    [(("0", "4"), 4), (("4", "input"), 3), (("output", "input", "4"), 5), (("0", "0"), 0)],
)
def test_the_gravest_status_is_that_of_the_command(drives, contents, status):
    assert drives(dict(zip("abc", contents, strict=False)))[0] == status
    with pytest.raises(InterruptionError):  # an interrupt ends all
        drives({"d": "ctrl-c", "e": "0"})


def test_finished_logs_are_passed_over_until_something_changes(drives, tmp_path, capsys):
    contents = {"a": "0", "b": "0"}
    drives(contents)
    assert drives(contents) == (0, [])
    assert capsys.readouterr().out.count("unchanged, kept the result in") == 2
    assert drives(contents, overwrite=True)[1] == ["a.mcap", "b.mcap"]
    for how in ("every_region", "self_calibrate"):
        for again in (["a.mcap", "b.mcap"], []):
            assert drives(contents, **{how: True})[1] == again
    camera = tmp_path / "camera.yaml"
    camera.write_text("one")
    given, _ = load_settings(options={"read.calibration": str(camera)})
    for changed in (["a.mcap", "b.mcap"], []):
        assert drives(contents, given)[1] == changed
    camera.write_text("another")
    assert drives(contents, given)[1] == ["a.mcap", "b.mcap"]
    drives(contents)
    with pytest.raises(OutputError, match="of another log"):
        drives(contents | {"b": "4"})
    drives(contents)
    (tmp_path / "out" / "b" / "signs.parquet").unlink()
    assert drives(contents)[1] == ["b.mcap"]


def test_two_logs_of_one_name_are_refused_before_any_is_run(tmp_path):
    with pytest.raises(UsageError, match="two logs are named"):
        process_all([tmp_path / "a.mcap"] * 2, [tmp_path] * 2, SETTINGS, None, RunOptions())
