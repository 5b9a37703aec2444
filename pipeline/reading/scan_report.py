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

    def __str__(self) -> str:
        """One line for a person."""
        return f"at byte {self.offset}: {self.what}"


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

    def add_problem(self, offset: int, what: str) -> None:
        """Count a problem and keep its words while there is room."""
        self.problem_count += 1
        if self.problem_count <= MOST_PROBLEMS:
            self.problems.append(Problem(offset, what))
        elif self.problem_count == MOST_PROBLEMS + 1:
            self.problems.append(Problem(offset, "more problems follow, not listed"))

    def add_remark(self, offset: int, what: str) -> None:
        """Keep in words what was found amiss and made good."""
        if len(self.remarks) < MOST_PROBLEMS:
            self.remarks.append(Problem(offset, what))
