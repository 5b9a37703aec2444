"""Errors for people: what is wrong, where, and what to do."""

PARTS_LOST = 4
"""Exit status of work that is done, but lost parts of its input."""
INTERRUPTED = 130
"""Exit status of work that a person or the system stopped."""


class WaysideError(Exception):
    """Base of every error that wayside raises on purpose; `exit_status` is what the command ends with."""

    exit_status = 1


class UsageError(WaysideError):
    """An argument, option or setting that cannot be used."""

    exit_status = 2


class InputError(WaysideError):
    """The log, calibration or image folder cannot be used."""

    exit_status = 3


class OutputError(WaysideError):
    """A result could not be written."""

    exit_status = 5


class InterruptionError(WaysideError):
    """Ctrl-C, or a signal that asks to end."""

    exit_status = INTERRUPTED


class StageError(WaysideError):
    """A fault inside a stage, with the stage and the frame it happened in."""

    def __init__(self, stage: str, frame: int | None, cause: BaseException) -> None:
        where = "" if frame is None else f" at frame {frame}"
        super().__init__(f"stage {stage} failed{where}: {type(cause).__name__}: {cause}")
        self.stage, self.frame, self.cause = stage, frame, cause
