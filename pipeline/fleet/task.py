"""One log of a fleet, carried out wherever there is a worker. It can be repeated with the same result.

An attempt stands in the log's own file on disk before its work starts. So the attempts that killed their worker are
counted by whoever begins the next one, in whatever process or machine, also after the fleet itself was ended.
"""

import faulthandler
import os
import socket
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path

from wayside.pipeline.calibration.command import self_calibrated
from wayside.pipeline.files.output_folder import finish_replacement
from wayside.pipeline.files.visible_text import visible_lines
from wayside.pipeline.files.writing import not_written, write_file
from wayside.pipeline.fleet.manifest import DRIVES, LOGS, QUARANTINE, Entry, State, finished
from wayside.pipeline.fleet.sources import UnreachableError, fetched
from wayside.pipeline.models.model_files import Models, load_models
from wayside.pipeline.results.result import is_finished, log_fingerprint
from wayside.pipeline.running.journal import result_keys
from wayside.pipeline.running.run import RunRequest, run_log
from wayside.pipeline.running.tuning import tune_process
from wayside.schemas.errors import InputError, OutputError, StageError, UsageError, WaysideError
from wayside.schemas.settings import ReadSettings, RouteSettings, Settings

_BEGUN, _DONE, _UNCOUNTED = "begun", "done", "not counted"
_QUARANTINED_LOG, _QUARANTINED_ERROR = "log.txt", "error.txt"


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """How a fleet is carried out; of what is here, only `self_calibrate` changes a result."""

    jobs: int | None = None
    """Logs side by side. None: one, or the threads of the scheduler."""
    scheduler: str | None = None
    """Address of a Dask scheduler, or `local`. None: processes without Dask."""
    attempts: int = 3
    """How often a log is begun before it goes into quarantine."""
    retry: bool = False
    """Try the logs in quarantine again."""
    overwrite: bool = False
    """Replace results of logs whose content has changed since."""
    self_calibrate: bool = False
    """Calibrate each log by its own drive first."""
    arguments: tuple[str, ...] = ()
    """The command line, for `run.json`."""


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker needs of a log."""

    entry: Entry
    """As it was before this attempt."""
    inventory: Path
    """Absolute, which workers on other machines see too."""
    settings: Settings
    """Of the run; models are loaded by the worker."""
    options: FleetOptions

    @property
    def folder(self) -> Path:
        """Where the result goes."""
        return self.inventory / DRIVES / self.entry.name

    @property
    def log(self) -> Path:
        """The file with the attempts of this log."""
        return self.inventory / LOGS / f"{self.entry.name}.txt"

    @property
    def quarantine(self) -> Path:
        """Where its file and the last error go, when all attempts are used up."""
        return self.inventory / QUARANTINE / self.entry.name

    def begun(self) -> int:
        """How many attempts were begun for its key, less those that ended well or do not count."""
        try:
            lines = self.log.read_text("utf-8", "replace").splitlines()
        except FileNotFoundError:
            return 0
        begun = 0
        for words in (line.partition(" ")[2] for line in lines):
            if words.startswith(f"{_BEGUN} {self.entry.key}"):
                begun += 1
            elif words.startswith(f"{_UNCOUNTED} {self.entry.key}"):
                begun -= 1
            elif words.startswith(_DONE):
                begun = 0
        return begun

    def note_end(self, death: str = "") -> None:
        """Write how its worker died, else that it was ended from outside, into its file; raises OutputError."""
        with _log_file(self) as note:
            note(death or f"{_UNCOUNTED} {self.entry.key}: interrupted")


def run_task(task: Task) -> Entry:
    """Run a log, unless its result stands already; its entry, `WAITING` where it is worth another attempt.

    A log that cannot be used goes into quarantine at once, because it will be the same the next time. Every other
    failure, also the death of a worker, is tried again until the attempts are used up. An output that cannot be written
    is no fault of the log: OutputError is raised, and that attempt does not count.
    """
    finish_replacement(task.folder)
    begun = task.begun()
    if is_finished(task.folder, task.entry.key):
        return finished(task.folder, replace(task.entry, attempts=begun))
    most = task.options.attempts
    if begun >= most:
        words = f"its worker died in attempt {begun} of {most}"
        return _quarantined(task, replace(task.entry, status=1, attempts=begun, words=words))
    entry = replace(task.entry, attempts=begun + 1)
    with _log_file(task) as note:
        note(f"{_BEGUN} {entry.key} on {here()}: {entry.source}")
        start = time.perf_counter()
        try:
            _run(task)
            note(f"{_DONE} in {time.perf_counter() - start:.1f} s")
        except (KeyboardInterrupt, OutputError) as error:
            note(f"{_UNCOUNTED} {entry.key}: {str(error) or 'interrupted'}")
            raise  # of an interruption, the fleet may not be there any more to note it
        except Exception as error:
            words, status = f"{type(error).__name__}: {error}", StageError.exit_status
            if isinstance(error, WaysideError):
                words, status = str(error), error.exit_status
            note(traceback.format_exc() if status == StageError.exit_status else words)
            hopeless = isinstance(error, InputError | UsageError)
            last = entry.attempts >= most or (hopeless and not isinstance(error, UnreachableError))
        else:
            _leave_quarantine(task)
            return finished(task.folder, entry)
    seconds = round(time.perf_counter() - start, 3)
    entry = replace(entry, state=State.WAITING, status=status, seconds=seconds, words=words)
    return _quarantined(task, entry) if last else entry


def _run(task: Task) -> None:
    """Run the log of a task in this process."""
    with fetched(task.entry.source) as log:
        if log_fingerprint(log) != task.entry.fingerprint:
            raise UnreachableError(
                f"{task.entry.source}: on {here()}, the log is missing or not as the fleet found it. Workers must see "
                "the same files, and logs must not change."
            )
        # Models depend on neither, which may be of the log alone.
        models = _models(replace(task.settings, read=ReadSettings(), route=RouteSettings()))
        options, digests = task.options, models.digests()
        key_of = result_keys(task.settings, digests, self_calibrate=options.self_calibrate)
        if key_of(task.entry.fingerprint) != task.entry.key:
            raise WaysideError(
                f"wayside, its packages or its models differ on {here()} from where the fleet was started. Install "
                "the same on every worker."
            )
        tune_process()
        asked = RunRequest(log, task.folder, task.settings, models, options.arguments)
        if options.self_calibrate:
            asked = replace(asked, calibrate=partial(self_calibrated, overwrite=options.overwrite))
        run_log(replace(asked, overwrite=options.overwrite))


@lru_cache(maxsize=1)
def _models(settings: Settings) -> Models:
    """Models, kept from one log to the next."""
    return load_models(settings)


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


def _quarantined(task: Task, entry: Entry) -> Entry:
    """Put the file of a log into quarantine, with the last error; its entry."""
    folder = task.quarantine
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            os.replace(task.log, folder / _QUARANTINED_LOG)
    except OSError as error:
        raise not_written(folder, error) from error
    text = (
        f"{entry.source}\nattempts: {entry.attempts}\nexit status: {entry.status}\n{entry.words}\n"
    )
    write_file(folder / _QUARANTINED_ERROR, visible_lines(text).encode(), overwrite=True)
    return replace(entry, state=State.QUARANTINED)


def _leave_quarantine(task: Task) -> None:
    """Remove what an earlier fleet wrote about a log that is done now."""
    with suppress(OSError):  # it is not there, or holds something of the user's
        for name in (_QUARANTINED_LOG, _QUARANTINED_ERROR):
            (task.quarantine / name).unlink(missing_ok=True)
        task.quarantine.rmdir()


def here() -> str:
    """This machine and process, in words."""
    return f"{socket.gethostname()}, process {os.getpid()}"
