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

    messages_stated: how many messages the summary counts, None where it does not say or was not reached;
    unchecked_chunks: chunks without a checksum; data_checked: the checksum over the whole log was compared.
    """

    bytes_total: int = 0
    bytes_read: int = 0
    messages: int = 0
    messages_stated: int | None = None
    chunks: int = 0
    lost_chunks: int = 0
    unchecked_chunks: int = 0
    data_checked: bool = False
    unknown_records: int = 0
    compressions: Counter[str] = field(default_factory=Counter)
    first_log_ns: int | None = None
    last_log_ns: int | None = None
    problems: list[Problem] = field(default_factory=list)
    problem_count: int = 0
    remarks: list[Problem] = field(default_factory=list)

    @property
    def unchecked(self) -> list[str]:
        """What of the log has no checksum, in words; empty where all has one."""
        if self.data_checked or not self.messages or self.chunks > self.unchecked_chunks == 0:
            return []
        if self.chunks > self.unchecked_chunks:
            count = f"{self.unchecked_chunks} of {self.chunks} chunks have"
        else:
            count = "the log has"
        return [f"{count} no checksum: damage inside of messages would not show"]

    @property
    def lost(self) -> bool:
        """Whether parts of the log could not be read."""
        return self.problem_count > 0

    def add_problem(self, offset: int, what: str, part: str = "") -> None:
        """Count a problem and keep its words while there is room."""
        self.problem_count += 1
        if self.problem_count <= MOST_PROBLEMS:
            self.problems.append(Problem(offset, what, part))
        elif self.problem_count == MOST_PROBLEMS + 1:
            self.problems.append(Problem(offset, "more problems follow, not listed"))

    def add_remark(self, offset: int, what: str, part: str = "") -> None:
        """Keep in words what was found amiss and made good."""
        if len(self.remarks) < MOST_PROBLEMS:
            self.remarks.append(Problem(offset, what, part))

    def absorb(self, part: ScanReport, name: str, *, first: bool) -> None:
        """Add what a scan of one part of the log came across; places are told with the name of its file."""
        for count in ("messages", "chunks", "lost_chunks", "unchecked_chunks", "unknown_records"):
            setattr(self, count, getattr(self, count) + getattr(part, count))
        stated = None if first else self.messages_stated
        if part.messages_stated is not None and (first or stated is not None):
            self.messages_stated = (stated or 0) + part.messages_stated
        else:
            self.messages_stated = None
        self.data_checked = part.data_checked and (first or self.data_checked)
        self.compressions.update(part.compressions)
        times = [t for t in (self.first_log_ns, part.first_log_ns) if t is not None]
        self.first_log_ns = min(times, default=None)
        times = [t for t in (self.last_log_ns, part.last_log_ns) if t is not None]
        self.last_log_ns = max(times, default=None)
        for one in part.problems:
            self.add_problem(one.offset, one.what, name)
        self.problem_count += part.problem_count - len(part.problems)
        for one in part.remarks:
            self.add_remark(one.offset, one.what, name)
