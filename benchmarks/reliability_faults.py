"""Faults of logs, of files that wayside reads, and in the place of results, each in many forms: what becomes of them.

    PYTHONPATH=. .venv/bin/python benchmarks/reliability_faults.py [--tries 30] [--only NAME]

Right: everything sound is used, and there is nothing to tell. Told: what is lost or odd is counted or noted, and all
else is used. Refused: ended with words for a person. Wrong: anything else - a message lost without a word or with other
bytes, another exception, a crash, more processor time or memory than `mutations.py` allows, a file of the user's gone.
Faults of clocks and positions: reliability_clocks.py; kills, full disks: reliability_kills.py, reliability_disk.py.
"""

from __future__ import annotations

import argparse
import random
import struct
import sys
import tempfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mutations import PACKINGS, Attempt, Found, Prepare, Tally, isolated, read, small_log
from odd_files import (
    bad_calibration,
    bad_result,
    boxes_beyond_measure,
    deep_settings,
    no_unit,
    parquet_bombs,
)
from reliability_logs import BARE

from recordings.drives.messages.dialects import DIALECTS
from wayside.pipeline.earlier_result import check_earlier
from wayside.pipeline.information import describe_log, format_information
from wayside.pipeline.output_folder import OutputFolder
from wayside.pipeline.reading.image_headers import read_image_header
from wayside.pipeline.reading.layout import MAGIC, RECORD_HEAD
from wayside.pipeline.reading.records import Message, scan
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.schemas.frame import USED, Frame
from wayside.stages.imaging import decode

Change = Callable[[bytearray, random.Random], bytes | bytearray]


def records_of(content: bytes | bytearray) -> list[tuple[int, int, int]]:
    """Opcode, start and end of the records of a sound log up to the end of its data."""
    found, at = [], len(MAGIC)
    while True:
        opcode, length = RECORD_HEAD.unpack_from(content, at)
        end = at + RECORD_HEAD.size + length
        found.append((opcode, at, end))
        if opcode == Opcode.DATA_END:
            return found
        at = end


@cache
def sound_logs(summary: bool) -> list[tuple[str, tuple[bytes, Found]]]:
    """Small logs of every dialect and packing, and their messages."""
    logs = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        for dialect in DIALECTS:
            for name, options in PACKINGS.items():
                more = options | {"chunk_size": 6000} | ({} if summary else BARE)
                content = small_log(dialect, 8, **more)
                path.write_bytes(content)
                logs.append((name, (content, read(path))))
    return logs


def of_logs(change: Change, *, chunked: bool = True, summary: bool = True) -> Prepare:
    """A change to small logs of every dialect and packing."""

    def prepare(folder: Path) -> Attempt:
        path = folder / "log.mcap"
        logs = [log for name, log in sound_logs(summary) if not chunked or name != "not chunked"]

        def attempt(tally: Tally, rng: random.Random) -> None:
            content, whole = rng.choice(logs)
            path.write_bytes(change(bytearray(content), rng))
            report = ScanReport()

            def work() -> list[tuple[str, int, bytes]]:
                return [
                    (m.channel.topic, m.sequence, bytes(m.data))
                    for m in scan(path, report)
                    if isinstance(m, Message)
                ]

            found = tally.attempt(work)
            if found is not None:
                lost = len(whole) - len(found)
                said = report.problem_count or report.unchecked
                tally.wrong += any(one not in whole for one in found) or (lost > 0 and not said)
                tally.told += bool(said)
                if said:
                    tally.attempt(lambda: format_information(describe_log(path)))

        return attempt

    return prepare


def inserted(record: Callable[[random.Random], bytes]) -> Change:
    """A record put between two others before the end of the data."""

    def change(content: bytearray, rng: random.Random) -> bytearray:
        at = rng.choice(
            [
                start
                for opcode, start, _ in records_of(content)
                if opcode in (Opcode.CHUNK, Opcode.DATA_END)
            ]
        )
        return content[:at] + record(rng) + content[at:]

    return change


def chunk(name: str, data: bytes, packed: bytes) -> bytes:
    """A chunk record."""
    head = struct.pack("<QQQI", 1, 2, len(data), zlib.crc32(data))
    body = (
        head
        + struct.pack("<I", len(name))
        + name.encode()
        + struct.pack("<Q", len(packed))
        + packed
    )
    return RECORD_HEAD.pack(Opcode.CHUNK, len(body)) + body


@cache
def bombs() -> list[bytes]:
    """Chunks that unpack to far more than they are: zeros, empty records, many that are right one by one."""
    zeros, records, some = bytes(50_000_000), RECORD_HEAD.pack(0x90, 0) * 600_000, bytes(4_000_000)
    return [
        chunk("zstd", zeros, zstandard.compress(zeros)),
        chunk("lz4", zeros, lz4.frame.compress(zeros)),
        chunk("zstd", records, zstandard.compress(records)),
        20 * chunk("zstd", some, zstandard.compress(some)),
    ]


def bomb(rng: random.Random) -> bytes:
    """One of them."""
    return rng.choice(bombs())


def a_chunk(content: bytearray, rng: random.Random) -> tuple[int, int]:
    """Where a chunk begins and ends."""
    return rng.choice(
        [(start, end) for opcode, start, end in records_of(content) if opcode == Opcode.CHUNK]
    )


def flipped(content: bytearray, rng: random.Random) -> bytearray:
    """A bit of the first chunk changed."""
    start, end = next((s, e) for opcode, s, e in records_of(content) if opcode == Opcode.CHUNK)
    content[rng.randrange(start + 60, end)] ^= 1 << rng.randrange(8)
    return content


def missing(content: bytearray, rng: random.Random) -> bytearray:
    """Bytes missing from a chunk."""
    start, end = a_chunk(content, rng)
    at = rng.randrange(start + 60, end)
    del content[at : min(at + rng.randrange(1, 200), end)]
    return content


def other_opcode(content: bytearray, rng: random.Random) -> bytearray:
    """The kind of a chunk changed."""
    content[a_chunk(content, rng)[0]] = rng.choice([0, 1, 3, 5, 7, 9, 11, 12, 15, 0x80, 0xFF])
    return content


def no_record(rng: random.Random) -> bytes:
    """A record without a kind."""
    return RECORD_HEAD.pack(0, n := rng.randrange(400)) + rng.randbytes(n)


def of_images(make: Callable[[random.Random], bytes], wanted: str) -> Prepare:
    """An image that must have a status."""

    def prepare(_: Path) -> Attempt:
        def attempt(tally: Tally, rng: random.Random) -> None:
            data = make(rng)

            def work() -> str:
                header = read_image_header(data) or ("jpeg", 0, 0)
                camera: Any = None
                if wanted == "wrong_size":
                    camera = _Size
                (image,) = decode(iter([Frame(0, 0, None, USED, "", data, camera, *header[1:])]))
                return image.frame.status

            status = tally.attempt(work)
            tally.told += status in (wanted, "undecodable")
            tally.wrong += status not in (wanted, "undecodable")

        return attempt

    return prepare


class _Size:
    width, height = 1600, 1200


def half_jpeg(rng: random.Random) -> bytes:
    """A JPEG that ends early."""
    pixels = cv2.resize(
        np.random.default_rng(rng.randrange(9)).integers(0, 256, (9, 12, 3), np.uint8), (320, 240)
    )
    data = cv2.imencode(".jpg", pixels)[1].tobytes()
    return data[: rng.randrange(len(data) // 3, len(data) - 30)]


def huge_image(rng: random.Random) -> bytes:
    """A header of some kilobytes that calls itself 20,000 to 65,000 pixels wide."""
    side = rng.randrange(20_000, 65_000)
    if rng.random() < 0.5:
        head = b"II*\0\x08\0\0\0\x04\0"
        for tag, kind, value in ((256, 4, side), (257, 4, side), (258, 3, 8), (262, 3, 1)):
            head += struct.pack("<HHII", tag, kind, 1, value)
        return head + bytes(6000)
    small = bytearray(cv2.imencode(".jpg", np.zeros((16, 16, 3), np.uint8))[1].tobytes())
    at = small.find(b"\xff\xc0")
    small[at + 5 : at + 9] = struct.pack(">HH", side, side)
    return bytes(small)


def refused(work: Callable[[Path, random.Random], object]) -> Prepare:
    """What must end with words."""

    def prepare(folder: Path) -> Attempt:
        def attempt(tally: Tally, rng: random.Random) -> None:
            before = tally.refused + sum(tally.faults.values())
            tally.attempt(lambda: work(folder, rng))
            tally.wrong += tally.refused + sum(tally.faults.values()) == before

        return attempt

    return prepare


def of_folders(folder: Path) -> Attempt:
    """Something of the user's in the place of a result: it must stand as before."""

    def attempt(tally: Tally, rng: random.Random) -> None:
        out = Path(tempfile.mkdtemp(dir=folder))
        name = rng.choice(
            ["signs.parquet", "observations.parquet", "frames.parquet", "run.json", "drive.rrd"]
        )
        target = out / name
        kind = rng.randrange(3)
        if kind == 0:
            target.write_bytes(rng.randbytes(50))
        elif kind == 1:
            target.symlink_to(out / "elsewhere")
        else:
            target.mkdir()
        before = sorted(
            (p.name, p.is_symlink(), p.is_file() and p.read_bytes()) for p in out.iterdir()
        )

        def work() -> None:
            with OutputFolder(out, kept=("drive.rrd",)) as output:
                check_earlier(out, folder / "log.mcap").check_recording()
                (output.part / name).write_bytes(b"new")
                output.commit()

        tally.attempt(work)
        after = sorted(
            (p.name, p.is_symlink(), p.is_file() and p.read_bytes()) for p in out.iterdir()
        )
        tally.wrong += before != after

    return attempt


FAULTS: dict[str, Prepare] = {
    "3 chunks that unpack to 5 to 50 MB, or 20 times 4 MB": of_logs(inserted(bomb)),
    "3 records without a kind (opcode 0)": of_logs(inserted(no_record), chunked=False),
    "3 headers of images of 20,000 to 65,000 pixels": of_images(huge_image, "wrong_size"),
    "4 a bit of the first chunk, no summary": of_logs(flipped, summary=False),
    "4 a bit of the first chunk": of_logs(flipped),
    "4 bytes missing from a chunk": of_logs(missing),
    "4 the kind of a chunk changed": of_logs(other_opcode),
    "4 JPEGs that end early": of_images(half_jpeg, "damaged"),
    "6 files, links, folders of the user's in the place of a result": of_folders,
    "6 a run.json that is none, deep or odd": refused(bad_result),
    "7 settings without end, not text, infinite": refused(deep_settings),
    "7 calibrations that cannot be, YAML made to grow": refused(bad_calibration),
    "7 boxes in Parquet that unpack beyond measure": refused(boxes_beyond_measure),
    "7 a spacing without a unit": refused(no_unit),
}


def main() -> int:
    """Try and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tries", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    if not args.only:
        (
            bombs(),
            parquet_bombs(),
            sound_logs(True),
            sound_logs(False),
        )  # made before the processes that are timed
    wrong = 0
    print(
        "| point and fault | tried | right | told | refused | wrong | slowest, ms of CPU | memory grown, MB |"
    )
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as scratch:
        for name, prepare in FAULTS.items():
            if args.only not in name:
                continue
            tally = isolated(name, prepare, args.tries, args.seed, Path(scratch))
            for fault, times in tally.faults.most_common():
                print(f"{name}: {times} x {fault}", file=sys.stderr)
            bad = tally.wrong + sum(tally.faults.values())
            wrong += bad
            right = tally.tries - tally.told - tally.refused - bad
            print(
                f"| {name} | {tally.tries} | {right} | {tally.told} | {tally.refused} | {bad} | "
                f"{1e3 * tally.slowest_s:.0f} | {tally.grown_mb:.0f} |",
                flush=True,
            )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
