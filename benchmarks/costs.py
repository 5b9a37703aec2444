"""What a run costs, in decodes of the same images, compared with alternatives.

    .venv/bin/python benchmarks/costs.py .cache/drives/straight.mcap [--times 10] [--rounds 3] [--peers PYTHON]

A decode is that of an image of the log into memory that is used again, timed before and after every other measurement.
Every way is a process of its own, start and all; the ways take turns, and the table holds medians. The long log is the
short one played over and over: its images and calibration only, times moved on, so both run from the known spacing.

--peers: a Python that has ultralytics and pycolmap, which then run on the same images (`cost_peers.py`).
Prints tables.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import simplejpeg
from common import BENCHMARKS, WAYSIDE, print_table
from faulty_logs import CALIBRATION, IMAGE, Logged, edited, read_log, write_log

from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.tuning import tune_process
from wayside.schemas.settings import ReadSettings

SPACING = "26.4ft"
PAUSE_NS = 300_000_000  # between two turns
PEERS = {"yolo": 12, "plain": 2, "pycolmap": 24}
"""Other programs, and on how many images they run."""
SIDE_BY_SIDE = "decode propose detect features segment color shape sift".split()
"""Stages in the workers; whatever else a run counts is in order, in one thread."""
FIRST_IMAGE = """
import sys
from pathlib import Path
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.flow import Flow
from wayside.pipeline.workers import StageClock
settings, _ = load_settings(assignments=["read.spacing_m=8"])
flow = Flow(settings, load_models(settings), StageClock())
next(flow.detect(read_frames(Path(sys.argv[1]), settings.read, ReadReport())))
"""


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one process: images, processor and wall seconds, peak memory in MB, milliseconds of a decode meanwhile."""

    images: int
    processor: float
    wall: float
    peak: float
    decode: float

    @property
    def ms(self) -> float:
        """Processor time of an image."""
        return 1000 * self.processor / self.images


class Decoder:
    """The yardstick: decodes the images of a log."""

    def __init__(self, log: Path) -> None:
        settings = ReadSettings(spacing_m=8.0, thin_m=0.0)
        frames = read_frames(log, settings, ReadReport())
        self._data = [bytes(one.data) for one in frames if one.used]
        tune_process()

    def ms(self) -> float:
        """Median over the images."""
        spent, pixels = [], simplejpeg.decode_jpeg(self._data[0], "RGB")
        for data in self._data:
            start = time.thread_time()
            simplejpeg.decode_jpeg(data, "RGB", buffer=pixels)
            spent.append(time.thread_time() - start)
        return 1000 * median(spent)


def main() -> int:
    """Measure and print."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--peers", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        bench = Bench(args.log, Path(scratch), args.times)
        print_table(
            ["way", "images", "ms an image", "decodes", "images/s", "peak MB"],
            bench.rows(bench.ways(args.peers), args.rounds),
        )
        print()
        print_table(["stage", "ms an image", "decodes"], bench.stages("default, 2 workers"))
        print()
        print_table(["workers", "images/s"], bench.rates("default, 2 workers"))
        print()
        print_table(["start", "wall s", "processor s"], bench.starts())
        files = [bench.about(f"default, {k}")["files"] for k in ("1 worker", "2 workers")]
    print(f"\nThe same bytes from 1 and 2 workers: {'yes' if files[0] == files[1] else 'NO'}.")
    return int(files[0] != files[1])


class Bench:
    """A short and a long log, and the ways to process them."""

    def __init__(self, log: Path, scratch: Path, times: int) -> None:
        self._scratch = scratch
        self._short, self._long = scratch / "short.mcap", scratch / "long.mcap"
        play(log, self._short, 1)
        play(log, self._long, times)
        self._decoder = Decoder(self._short)
        self._count = len(self._decoder._data)
        self._times = times

    def ways(self, peers: Path | None) -> dict[str, Callable[[str], Cost]]:
        """By name; each takes its name."""
        long, many = self._long, self._times
        found: dict[str, Callable[[str], Cost]] = {
            "default, 1 worker": lambda n: self._run(n, long, many, "--workers", "1"),
            "default, 2 workers": lambda n: self._run(n, long, many),
            "the short log": lambda n: self._run(n, self._short, 1),
            "recorded for the viewer": lambda n: self._run(n, long, many, "--view", "file"),
            "preset report": lambda n: self._run(n, self._short, 1, "--preset", "report"),
        }
        if peers is not None:
            found |= {name: lambda n: self._peer(peers, n) for name in PEERS}
        return found

    def rows(self, ways: dict[str, Callable[[str], Cost]], rounds: int) -> list[list[object]]:
        """A row a way: medians of its rounds."""
        self._run("warm", self._short, 1)  # compiles kernels where no cache is
        found: dict[str, list[Cost]] = defaultdict(list)
        for _ in range(rounds):
            for name, way in ways.items():
                found[name].append(way(name))
        return [
            [
                name,
                costs[0].images,
                f"{median(c.ms for c in costs):.0f}",
                f"{median(c.ms / c.decode for c in costs):.1f}",
                f"{median(c.images / c.wall for c in costs):.1f}",
                f"{median(c.peak for c in costs):.0f}",
            ]
            for name, costs in found.items()
        ]

    def stages(self, way: str) -> list[list[str]]:
        """A row a stage of the last run of a way, and one each for those in the workers and those in order."""
        spent, decode = self._spent(way), self._decoder.ms()
        rows = [(name, ms) for name, ms in spent.items() if ms >= 0.05]
        shared = sum(spent.get(name, 0.0) for name in SIDE_BY_SIDE)
        rows += [("side by side", shared), ("in order", sum(spent.values()) - shared)]
        return [[name, f"{ms:.1f}", f"{ms / decode:.2f}"] for name, ms in rows]

    def rates(self, way: str) -> Iterator[list[object]]:
        """Rows: what more workers would give; the whole is shared, but what is in order takes one thread."""
        spent = self._spent(way)
        order = sum(ms for name, ms in spent.items() if name not in SIDE_BY_SIDE)
        for count in (1, 2, 4, 8, 16):
            yield [count, f"{1000 / max(order, sum(spent.values()) / count):.1f}"]

    def starts(self) -> list[list[str]]:
        """Rows: help, the first image, and the first run after an installation, and the next one."""
        run = self._command("start", self._short)
        fresh = {"NUMBA_CACHE_DIR": str(self._scratch / "kernels")}
        first = [sys.executable, "-c", FIRST_IMAGE, self._short]
        ways = {
            "wayside --help": ([WAYSIDE, "--help"], {}, 5),
            "to the first image": (first, {}, 5),
            "short log, kernels not compiled yet": (run, fresh, 1),
            "short log, compiled": (run, {}, 1),
        }
        rows = []
        for name, (command, variables, times) in ways.items():
            costs = [self._child(command, 1, variables) for _ in range(times)]
            spent = (median(c.wall for c in costs), median(c.processor for c in costs))
            rows.append([name, *(f"{one:.2f}" for one in spent)])
        return rows

    def _run(self, name: str, log: Path, times: int, *more: str) -> Cost:
        return self._child([*self._command(name, log), *more], self._count * times)

    def _command(self, name: str, log: Path) -> list[object]:
        run = [WAYSIDE, "run", log, "-o", self._scratch / name, "--overwrite"]
        return [*run, "--spacing", SPACING, "--set", "read.thin_m=0"]

    def about(self, way: str) -> Any:
        """What `run.json` says of the last run of a way."""
        return json.loads((self._scratch / way / "run.json").read_text())

    def _spent(self, way: str) -> dict[str, float]:
        """Milliseconds an image of each stage, in the last run of a way."""
        about = self.about(way)
        spent, images = about["times"]["cpu_s_by_stage"], about["accounting"]["frames_read"]
        return {name: 1000 * seconds / images for name, seconds in spent.items()}

    def _peer(self, python: Path, name: str) -> Cost:
        program = "peer.py" if name == "pycolmap" else "cost_peers.py"
        words = [self._scratch / "peer.npz"] if name == "pycolmap" else [name]
        command = [python, BENCHMARKS / program, self._short, *words, PEERS[name]]
        return self._child(command, PEERS[name])

    def _child(
        self, command: list[object], images: int, variables: dict[str, str] | None = None
    ) -> Cost:
        """Run a process, decoding before and after it."""
        before, start = self._decoder.ms(), time.perf_counter()
        child = subprocess.Popen(
            list(map(str, command)),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"OMP_NUM_THREADS": "1"} | (variables or {}),
        )
        _, status, used = os.wait4(child.pid, 0)
        wall = time.perf_counter() - start
        if status != 0 and images != PEERS["pycolmap"]:  # which says so where no model comes about
            raise SystemExit(f"{command}: ended with status {status}")
        processor = used.ru_utime + used.ru_stime
        decode = (before + self._decoder.ms()) / 2
        return Cost(images, processor, wall, used.ru_maxrss / 1024, decode)


def play(source: Path, target: Path, times: int) -> None:
    """Copy images and calibration of a log, `times` over with times moved on."""
    messages = [m for m in read_log(source) if m.topic in (IMAGE, CALIBRATION)]
    length_ns = messages[-1].log_ns - messages[0].log_ns + PAUSE_NS
    write_log(target, (later(m, turn, length_ns) for turn in range(times) for m in messages))


def later(message: Logged, turn: int, length_ns: int) -> Logged:
    """The message as it is logged in a later turn."""
    moved = edited(message, header_ns=turn * length_ns, log_ns=turn * length_ns)
    return replace(moved, data=numbered(moved.data, turn))


def numbered(message: bytes, turn: int) -> bytes:
    """The message with a number in the density of its JPEG, which no decoder heeds: equal images are left out."""
    start = message.find(b"\xff\xd8\xff\xe0")
    if start < 0:
        return message
    density = start + 14  # behind the markers, the length, "JFIF", the version and the unit
    return message[:density] + (turn + 1).to_bytes(4, "big") + message[density + 4 :]


if __name__ == "__main__":
    sys.exit(main())
