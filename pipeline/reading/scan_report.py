"""What reading a log came across: how much there is of it, what was lost and why."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

MOST_PROBLEMS = 200
"""Problems kept in words; further ones are counted only, so that a hopeless file cannot fill the memory."""


@dataclass(frozen=True, slots=True)
class Problem:
    """Something in the log that could not be used, where it begins, and what it cost."""

    offset: int
    what: str
    part: str = ""
    """File of a bag in which the offset counts; empty: the log is one file."""

    def __str__(self) -> str:
        """One line for a person."""
        where = f"{self.part}, at byte" if self.part else "at byte"
        return f"{where} {self.offset}: {self.what}"


@dataclass(slots=True)
class ScanReport:
    """What a scan came across, filled while it runs.

    `messages_stated`: how many messages the summary counts, None where it does not say or was not reached.
    `unchecked_messages`: those outside of chunks with a checksum. `unknown_records`: of kinds that are not known.
    `part`: file of a bag that is being read, empty where the log is one file.
    """

    part: str = ""
    bytes_total: int = 0
    bytes_read: int = 0
    messages: int = 0
    unchecked_messages: int = 0
    messages_stated: int | None = None
    chunks: int = 0
    lost_chunks: int = 0
    unknown_records: int = 0
    compressions: Counter[str] = field(default_factory=Counter)
    first_log_ns: int | None = None
    last_log_ns: int | None = None
    problems: list[Problem] = field(default_factory=list)
    problem_count: int = 0

    @property
    def unchecked(self) -> list[str]:
        """What may have been lost without a trace, in words."""
        notes = []
        if self.unchecked_messages:
            some = f"{self.unchecked_messages} of {self.messages} messages have"
            what = "the log has" if self.unchecked_messages == self.messages else some
            notes.append(f"{what} no checksum: damage inside of messages would not show")
        if self.unknown_records:
            notes.append(f"{self.unknown_records} records of unknown kinds were passed over")
        return notes

    @property
    def lost(self) -> bool:
        """Whether parts of the log could not be read."""
        return self.problem_count > 0

    def add_problem(self, offset: int, what: str) -> None:
        """Count a problem and keep its words while there is room."""
        self.problem_count += 1
        if self.problem_count <= MOST_PROBLEMS:
            self.problems.append(Problem(offset, what, self.part))
        elif self.problem_count == MOST_PROBLEMS + 1:
            self.problems.append(Problem(offset, "more problems follow, not listed"))

    def add_message(self, log_time_ns: int, *, checked: bool) -> None:
        """Count a message that is used."""
        self.messages += 1
        self.unchecked_messages += not checked
        first, last = self.first_log_ns, self.last_log_ns
        self.first_log_ns = log_time_ns if first is None else min(first, log_time_ns)
        self.last_log_ns = log_time_ns if last is None else max(last, log_time_ns)
