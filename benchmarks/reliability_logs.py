"""Cut logs at every byte and change bytes of all that is read: what is had of them, and whether anything breaks.

    PYTHONPATH=. .venv/bin/python benchmarks/reliability_logs.py [--cuts N] [--mutations M] [--seed S] [--page]

Every log is written by the stock MCAP writer. One process: a crash ends it, and nothing is written. With --page the
sections "Cut at every byte" and "Mutated logs" of benchmarks/reliability.md are written anew.
"""

from __future__ import annotations

import argparse
import io
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.opcode import Opcode
from mcap.writer import IndexType, Writer
from mutated_files import FILES
from mutations import (
    KINDS,
    LONGEST_S,
    MEMORY_BYTES,
    PACKINGS,
    Tally,
    mutation_table,
    read,
    small_log,
)
from unpackable import Reach, reach_of

from recordings.drives.messages.dialects import DIALECTS
from wayside.pipeline.information import describe_log, format_information
from wayside.pipeline.reading.layout import (
    MAGIC,
    RECORD_HEAD,
    parse_chunk_head,
    records_in,
    unpack_chunk,
)
from wayside.pipeline.reading.records import Message, scan
from wayside.pipeline.reading.scan_report import ScanReport

ROOT = Path(__file__).resolve().parents[1]
DEMO = ROOT / "recordings" / "demo.mcap"
PAGE = ROOT / "benchmarks" / "reliability.md"
CUTS, MUTATIONS = "## Cut at every byte", "## Mutated logs"
BARE: dict[str, Any] = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}


CUT_LINES = [
    "Logs cut off at evenly spread bytes, at most at every one. Of the messages that stand whole before the cut: the",
    "share that is read outside of the chunk that is cut, and of those inside it that its packing lets be had",
    "(`benchmarks/unpackable.py`: of lz4 and zstd whole blocks; a chunk under 64 or 128 kB is one block). By share:",
    "those inside that would be before the cut if packed and unpacked bytes ran evenly. Wrong: cuts after which",
    "something else than the first messages came. Faults: exceptions that are not words for a person.",
    "",
    "| log | bytes | cuts | outside of the cut chunk | inside | by share | wrong | faults | slowest, ms of CPU |",
    "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
]
MUTATION_LINES = [
    "Inputs with one to six bytes, runs of bytes or values changed, doubled, removed or made odd. Refused: ended with",
    "words for a person. Wrong: a message out of a chunk, which has a checksum, with other bytes than were written.",
    f"Faults: other exceptions, more than {LONGEST_S:g} s of CPU time, more than {MEMORY_BYTES >> 20} MB beyond the "
    "process, and crashes:",
    "attempts are made in a forked process with these limits.",
    "",
    "| input | tries | refused | wrong | faults | slowest, ms of CPU | memory grown, MB |",
    "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
]


def packed_anew(log: Path, **options: Any) -> bytes:
    """All messages of a log in another packing."""
    stream, channels = io.BytesIO(), {}
    writer = Writer(stream, **options)
    writer.start(library="benchmarks")
    for m in scan(log, ScanReport()):
        if not isinstance(m, Message) or m.channel.schema is None:
            continue
        if m.channel.id not in channels:
            s = m.channel.schema
            schema = writer.register_schema(s.name, s.encoding, s.data)
            channels[m.channel.id] = writer.register_channel(
                m.channel.topic, m.channel.encoding, schema
            )
        writer.add_message(
            channels[m.channel.id], m.log_time_ns, bytes(m.data), m.log_time_ns, m.sequence
        )
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


@dataclass(frozen=True, slots=True)
class Place:
    """Where a message ends: in the file where it is not packed, else its chunk and where it ends in what that holds."""

    end: int
    chunk_start: int = 0
    unpacked_end: int = 0
    unpacked_size: int = 1
    reach: Reach | None = None

    def is_had(self, cut: int) -> bool:
        """Whether the packing lets the message be had of a chunk that is cut at a byte of the file."""
        inside = self.reach is not None and self.end > cut > self.chunk_start
        return inside and self.unpacked_end <= self.reach[cut - self.chunk_start]

    def is_before(self, cut: int) -> bool:
        """Whether it lies in the same share of the unpacked bytes as is left of the packed ones."""
        inside = self.reach is not None and self.end > cut > self.chunk_start
        share = (cut - self.chunk_start) / (self.end - self.chunk_start) if inside else 0
        return inside and self.unpacked_end <= share * self.unpacked_size


def places_of(content: bytes) -> list[Place]:
    """Where each message of a sound log ends, in order."""
    places, position = [], len(MAGIC)
    while position < len(content) - len(MAGIC):
        opcode, length = RECORD_HEAD.unpack_from(content, position)
        body, end = position + RECORD_HEAD.size, position + RECORD_HEAD.size + length
        if opcode == Opcode.MESSAGE:
            places.append(Place(end))
        elif opcode == Opcode.CHUNK:
            head = parse_chunk_head(memoryview(content)[body:end], length)
            size = head.size
            data = unpack_chunk(head, memoryview(content)[body + size : end])
            reach = reach_of(head.compression, content[body + size : end])
            assert reach[-1] == len(data)
            last = 0
            for kind, inner in records_in(data):
                last += RECORD_HEAD.size + len(inner)
                if kind == Opcode.MESSAGE:
                    places.append(Place(end, body + size, last, len(data), reach))
        elif opcode == 0x0F:
            break
        position = end
    return places


def cut_table(most: int, folder: Path, only: str) -> Iterator[str]:
    """Rows of the table of cuts, one a log; of those whose name contains `only`."""
    logs: list[tuple[str, Callable[[], bytes], int]] = []
    for dialect in DIALECTS:
        for name, options in PACKINGS.items():
            for summary in (True, False):
                more = options | {"chunk_size": 1500} | ({} if summary else BARE)
                title = f"{dialect}, {name}{'' if summary else ', no summary'}"
                logs.append((title, lambda d=dialect, m=more: small_log(d, 2, **m), 10**9))
    for name, options in PACKINGS.items():
        title = f"demo drive, {name}" + ("" if name == "not chunked" else " of 1 MB")
        logs.append((title, lambda o=options: packed_anew(DEMO, **o), 2000))
    for title, make, limit in (log for log in logs if only in log[0]):
        yield _cut_row(title, make(), min(most, limit), folder / "cut.mcap")


def _cut_row(title: str, content: bytes, most: int, path: Path) -> str:
    path.write_bytes(content)
    whole, places, tally = read(path), places_of(content), Tally()
    assert len(whole) == len(places) > 0
    sizes = sorted(set(np.linspace(0, len(content) - 1, min(most, len(content))).astype(int)))
    before = before_found = inside = inside_found = by_share = 0
    for k, size in enumerate(reversed(sizes)):
        os.truncate(path, size)
        found = tally.attempt(lambda: read(path))
        if k % 50 == 0:
            tally.attempt(lambda: format_information(describe_log(path)))
        if found is None:
            found = []
        tally.wrong += found != whole[: len(found)]
        complete = sum(p.end <= size for p in places)
        had = sum(p.is_had(size) for p in places)
        before, before_found = before + complete, before_found + min(len(found), complete)
        inside += had
        inside_found += min(max(len(found) - complete, 0), had)
        by_share += sum(p.is_before(size) for p in places)
    share = f"{100 * inside_found / inside:.2f} %, {inside_found} of {inside}" if inside else "-"
    return (
        f"| {title} | {len(content)} | {len(sizes)} | {100 * before_found / max(before, 1):.2f} % | {share} | "
        f"{by_share} | {tally.wrong} | {sum(tally.faults.values())} | {1e3 * tally.slowest_s:.0f} |"
    )


def write_section(heading: str, lines: list[str]) -> None:
    """Put lines under a heading of the page in place of those that stand there."""
    page = PAGE.read_text() if PAGE.exists() else "# Reliability\n"
    before, found, rest = page.partition(f"{heading}\n")
    _, more, after = rest.partition("\n## ") if found else ("", "", "")
    section = f"{heading}\n\n" + "\n".join(lines) + "\n"
    PAGE.write_text(f"{before.rstrip()}\n\n{section}" + (f"\n## {after}" if more else ""))


def main() -> None:
    """Measure and print; with --page also write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--cuts", type=int, default=10**9, help="at most so many cuts of a log; 0: none"
    )
    parser.add_argument(
        "--mutations", type=int, default=2000, help="so many of each kind of input; 0: none"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--page", action="store_true", help="write benchmarks/reliability.md")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    options = f"--cuts {given.cuts} --mutations {given.mutations} --seed {given.seed}"
    command = f"`PYTHONPATH=. .venv/bin/python benchmarks/reliability_logs.py {options}`"
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for count, heading, lines, rows in (
            (given.cuts, CUTS, CUT_LINES, cut_table(given.cuts, folder, given.only)),
            (
                given.mutations,
                MUTATIONS,
                MUTATION_LINES,
                mutation_table(KINDS | FILES, given.mutations, given.seed, folder, given.only),
            ),
        ):
            if count:
                section = [command, "", *lines]
                print("\n".join(section), flush=True)
                for row in rows:
                    print(row, flush=True)
                    section.append(row)
                if given.page:
                    write_section(heading, section)


if __name__ == "__main__":
    main()
