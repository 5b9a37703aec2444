"""Logs whose content states the result of their run, and an engine in this process."""

import importlib
import json
from collections import Counter
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.fleet import running, task
from wayside.pipeline.fleet.engine import WorkerDeathError
from wayside.pipeline.fleet.folders import MERGED
from wayside.pipeline.fleet.merging import MergeReport
from wayside.pipeline.fleet.running import run_fleet
from wayside.pipeline.fleet.sources import expand_sources
from wayside.pipeline.fleet.task import FleetOptions
from wayside.pipeline.results.result import file_digest
from wayside.pipeline.running.journal import result_key
from wayside.schemas.errors import InputError, OutputError, StageError

from ..results import NO_MODELS

SETTINGS, _ = load_settings()
BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
FINDS_ALL = {"recall": 1.0, "outliers": 0.0, "false": 0.0, "misread": 0.0}


@pytest.fixture(scope="session")
def simulation():
    """The module `benchmarks/merging_simulation.py`: results of drives that no drive made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        return importlib.import_module("merging_simulation")


@pytest.fixture(scope="session")
def drive(simulation):
    """Writes the result of a drive along a road into an inventory; the true panel of each of its signs."""

    def write(inventory, name, road, rng, *, year=0, day=0, quality=FINDS_ALL, **more):
        start = simulation.START_NS + year * simulation.YEAR_NS + day * simulation.DAY_NS
        told = simulation.Quality(**quality)
        folder = inventory / "drives" / name
        return simulation.write_drive(folder, road, start, True, told, rng, **more)

    return write


def drives_of(inventory):
    """The results in an inventory."""
    return sorted((inventory / "drives").iterdir())


def rewrite(file, alter):
    """Change every row of a table."""
    table = pq.read_table(file)
    rows = table.to_pylist()
    for row in rows:
        row.update(alter(row))
    pq.write_table(pa.Table.from_pylist(rows, table.schema), file)


class Died(BaseException):
    """Stands for the death of a worker."""


class InProcess:
    """An engine of two places that carries a task out at once."""

    def places(self):
        return 2

    def submit(self, given):
        future = Future()
        try:
            future.set_result(task.run_task(given))
        except BaseException as error:
            future.set_exception(error)
        return future

    def result(self, future):
        if isinstance(error := future.exception(), Died):
            raise WorkerDeathError(f"its worker was killed by {error}")
        return future.result()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


@pytest.fixture
def fleet(tmp_path, monkeypatch):
    """Runs logs, by name and content, as a fleet; what it began, merged and reports."""
    seen = SimpleNamespace(began=[], merged=[], settings={}, times=Counter())
    seen.inventory = tmp_path / "inventory"

    def run_log(asked):
        log, folder, settings, models = asked.log, asked.folder, asked.settings, asked.models
        how = {"self_calibrate": asked.calibrate is not None}
        seen.began.append(log.stem)
        seen.settings[log.stem], seen.times[log.stem] = settings, seen.times[log.stem] + 1
        first, _, then = log.read_text().strip().partition(" then ")
        content = first if seen.times[log.stem] == 1 or not then else then
        if content.startswith("die"):
            raise Died("SIGKILL")
        if content == "ctrl-c":
            raise KeyboardInterrupt
        errors = {"input": InputError("no images"), "full": OutputError("the disk is full")}
        errors |= {"fault": StageError("track", 7, ValueError("nan"))}
        if content in errors:
            raise errors[content]
        folder.mkdir(parents=True, exist_ok=True)
        table = folder / "signs.parquet"
        table.write_text(content)
        about = {
            "wayside": "1",
            "result_key": result_key(log, settings, models.digests(), **how),
            "files": {table.name: {"rows": 3, "sha256": file_digest(table)}},
            "accounting": {"frames_read": 8, "lost": ["2 images"] if content == "lost" else []},
            "times": {"wall_s": 0.5},
        }
        (folder / "run.json").write_text(json.dumps(about))

    def merge(folders, out, settings, watch):
        seen.merged.append([folder.name for folder in folders])
        seen.merge_settings = settings
        for name in MERGED:
            (out / name).mkdir(exist_ok=True)
        return MergeReport(len(folders))

    task._models.cache_clear()
    for module in (task, running):
        monkeypatch.setattr(module, "load_models", lambda settings: NO_MODELS)
    monkeypatch.setattr(task, "run_log", run_log)
    monkeypatch.setattr(running, "merge_inventory", merge)

    def run(contents, settings=SETTINGS, engine=InProcess, given=None, own=None, **options):
        seen.began.clear()
        seen.merged.clear()
        for name, content in contents.items():
            log = tmp_path / "logs" / f"{name}.mcap"
            log.parent.mkdir(parents=True, exist_ok=True)
            log.write_text(content)
        uris = list(own or expand_sources(given or [str(tmp_path / "logs")]))
        how = {"open_engine": engine, "own": own}
        seen.report = run_fleet(uris, seen.inventory, settings, FleetOptions(**options), **how)
        seen.states = {entry.name: (entry.state, entry.status) for entry in seen.report.entries}
        return seen

    yield run
    task._models.cache_clear()
