"""One log of a fleet, carried out wherever there is a worker. It can be repeated with the same result.

An attempt stands in the log's own file on disk before its work starts. So the attempts that killed their worker are
counted by whoever begins the next one, in whatever process or machine, also after the fleet itself was ended.
"""

from __future__ import annotations

import faulthandler
import os
import socket
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from wayside.pipeline.files.output_folder import finish_replacement
from wayside.pipeline.files.parsing import CONTENT_FAULTS
from wayside.pipeline.files.visible_text import visible_lines
from wayside.pipeline.files.writing import not_written, write_file
from wayside.pipeline.fleet.manifest import DONE, DRIVES, LOGS, QUARANTINE, QUARANTINED, WAITING
from wayside.pipeline.fleet.sources import UnreachableError, fetched
from wayside.pipeline.models.model_files import Models, load_models
from wayside.pipeline.results.earlier_result import is_finished, log_fingerprint
from wayside.pipeline.results.result import read_run
from wayside.pipeline.running.journal import result_keys
from wayside.pipeline.running.run import RunRequest, run_log
from wayside.pipeline.running.tuning import tune_process
from wayside.schemas.errors import (
    PARTS_LOST,
    InputError,
    OutputError,
    StageError,
    UsageError,
    WaysideError,
)
from wayside.schemas.settings import Settings
from wayside.schemas.tables import SIGNS

_BEGUN, _DONE, _UNCOUNTED = "begun", "done", "not counted"
_QUARANTINED_LOG, _QUARANTINED_ERROR = "log.txt", "error.txt"


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker needs of a log: fields of its `Entry`, and arguments of `process_log`."""

    name: str
    source: str
    fingerprint: str
    key: str
    inventory: str
    """Absolute path of the inventory, which workers on other machines see too."""
    settings: Settings
    """Of the run; models are loaded by the worker."""
    attempts: int
    """How often it is begun before it is put into quarantine."""
    arguments: tuple[str, ...] = ()
    overwrite: bool = False

    @property
    def folder(self) -> Path:
        """Where the result goes."""
        return Path(self.inventory) / DRIVES / self.name

    @property
    def log(self) -> Path:
        """The file with the attempts of this log."""
        return Path(self.inventory) / LOGS / f"{self.name}.txt"


@dataclass(frozen=True, slots=True)
class Outcome:
    """The end of an attempt, with the fields of `Entry`. `WAITING`: it is worth another attempt."""

    state: str
    status: int
    attempts: int
    seconds: float = 0.0
    images: int = 0
    rows: int = 0
    words: str = ""


class _DiffersError(WaysideError):
    """What this worker has is not what the task was made of."""


def run_task(task: Task) -> Outcome:
    """Run a log, unless its result stands already.

    A log that cannot be used goes into quarantine at once, because it will be the same the next time. Every other
    failure, also the death of a worker, is tried again until the attempts are used up. An output that cannot be written
    is no fault of the log: that attempt does not count.

    Raises
    ------
    OutputError
        The inventory cannot be written, or something stands in the place of the result.
    """
    finish_replacement(task.folder)
    begun = begun_attempts(task)
    if is_finished(task.folder, task.key):
        return finished_outcome(task.folder, begun)
    if begun >= task.attempts:
        words = f"its worker died in attempt {begun} of {task.attempts}"
        return _quarantined(task, Outcome(QUARANTINED, StageError.exit_status, begun, words=words))
    with _log_file(task) as note:
        note(f"{_BEGUN} {task.key} on {here()}: {task.source}")
        start = time.perf_counter()
        try:
            _run(task)
            note(f"{_DONE} in {time.perf_counter() - start:.1f} s")
        except (KeyboardInterrupt, OutputError) as error:
            note(f"{_UNCOUNTED} {task.key}: {str(error) or 'interrupted'}")
            raise  # of an interruption, the fleet may not be there any more to note it
        except Exception as error:
            note(traceback.format_exc() if _status(error) == StageError.exit_status else str(error))
            failed = error
        else:
            _leave_quarantine(task)
            return finished_outcome(task.folder, begun + 1)
    hopeless = isinstance(failed, InputError | UsageError)
    last = begun + 1 >= task.attempts or (hopeless and not isinstance(failed, UnreachableError))
    words = (
        str(failed) if isinstance(failed, WaysideError) else f"{type(failed).__name__}: {failed}"
    )
    outcome = Outcome(
        QUARANTINED if last else WAITING,
        _status(failed),
        begun + 1,
        time.perf_counter() - start,
        words=words,
    )
    return _quarantined(task, outcome) if last else outcome


def begun_attempts(task: Task) -> int:
    """How many attempts were begun for the key of a task, less those that ended well or do not count."""
    try:
        lines = task.log.read_text("utf-8", "replace").splitlines()
    except FileNotFoundError:
        return 0
    begun = 0
    for words in (line.partition(" ")[2] for line in lines):
        if words.startswith(f"{_BEGUN} {task.key}"):
            begun += 1
        elif words.startswith(f"{_UNCOUNTED} {task.key}"):
            begun -= 1
        elif words.startswith(_DONE):
            begun = 0
    return begun


def note_end(task: Task, death: str = "") -> None:
    """Write into the file of a log how its worker died, else that it was ended from outside; raises OutputError."""
    with _log_file(task) as note:
        note(death or f"{_UNCOUNTED} {task.key}: interrupted")


def finished_outcome(folder: Path, attempts: int) -> Outcome:
    """The entry of `run.json` on the result in a folder. Raises InputError if it is not a result."""
    run = read_run(folder)
    try:
        counts, files, times = run["accounting"], run["files"], run["times"]
        return Outcome(
            DONE,
            PARTS_LOST if counts["lost"] else 0,
            attempts,
            float(times["wall_s"]),
            int(counts["frames_read"]),
            int(files[SIGNS.file]["rows"]),
        )
    except CONTENT_FAULTS as error:
        raise InputError(
            f"{folder}: the folder does not hold a result of wayside: {error!r}"
        ) from error


def _run(task: Task) -> None:
    """Run the log of a task in this process."""
    with fetched(task.source) as log:
        if log_fingerprint(log) != task.fingerprint:
            raise UnreachableError(
                f"{task.source}: on {here()}, the log is missing or not as the fleet found it. Workers must see the "
                "same files, and logs must not change."
            )
        models, key_of = _equipment(task.settings)
        if key_of(task.fingerprint) != task.key:
            raise _DiffersError(
                f"wayside, its packages or its models differ on {here()} from where the fleet was started. Install "
                "the same on every worker."
            )
        tune_process()
        asked = RunRequest(
            log, task.folder, task.settings, models, task.arguments, overwrite=task.overwrite
        )
        run_log(asked)


@lru_cache(maxsize=1)
def _equipment(settings: Settings) -> tuple[Models, Callable[[str], str]]:
    """Models, and the function that makes keys with them, kept from one log to the next."""
    models = load_models(settings)
    return models, result_keys(settings, models.digests(), every_region=False)


@contextmanager
def _log_file(task: Task) -> Iterator[Callable[[str], None]]:
    """A function that adds lines with the time to the file of a log; a crash of the process is reported there, too."""
    try:
        task.log.parent.mkdir(parents=True, exist_ok=True)
        with task.log.open("a", encoding="utf-8", errors="backslashreplace") as stream:
            faulthandler.enable(stream)

            def note(words: str) -> None:
                plain = visible_lines(words.rstrip()).replace("\n", "\n    ")
                stream.write(f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {plain}\n")
                stream.flush()
                os.fsync(stream.fileno())

            try:
                yield note
            finally:
                faulthandler.disable()
    except OSError as error:
        raise not_written(task.log.parent, error) from error


def _quarantined(task: Task, outcome: Outcome) -> Outcome:
    """Put the file of a log into quarantine, with the last error; the outcome."""
    folder = Path(task.inventory) / QUARANTINE / task.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            os.replace(task.log, folder / _QUARANTINED_LOG)
    except OSError as error:
        raise not_written(folder, error) from error
    text = f"{task.source}\nattempts: {outcome.attempts}\nexit status: {outcome.status}\n{outcome.words}\n"
    write_file(folder / _QUARANTINED_ERROR, visible_lines(text).encode(), overwrite=True)
    return outcome


def _leave_quarantine(task: Task) -> None:
    """Remove what an earlier fleet wrote about a log that is done now."""
    folder = Path(task.inventory) / QUARANTINE / task.name
    for name in (_QUARANTINED_LOG, _QUARANTINED_ERROR):
        with suppress(OSError):
            (folder / name).unlink()
    with suppress(OSError):  # it is not there, or holds something of the user's
        folder.rmdir()


def _status(error: Exception) -> int:
    return error.exit_status if isinstance(error, WaysideError) else StageError.exit_status


def here() -> str:
    """This machine and process, in words."""
    return f"{socket.gethostname()}, process {os.getpid()}"
