"""Odd names and odd kinds of files in every place where a command takes a path: what becomes of them.

    PYTHONPATH=. .venv/bin/python benchmarks/reliability_paths.py [--only NAME]

Every command is given, in turn for each of its paths: a name that is not there, one too long for the system, one with
bytes that are no UTF-8, a folder, an empty file, a path below it, a pipe nobody writes to, a device, a socket, a link
to itself and no name. Refused: ended with words and the exit status of a wrong argument, input or output; elsewhere:
likewise, but without the path. Done: ended with status 0 or 4, as an output may be of a name that is no UTF-8. Wrong: a
traceback, another status, fifteen seconds without any work, or as many of work. Prints a table and every case that is
wrong or elsewhere; ends with status 1 where one is wrong.
"""

from __future__ import annotations

import argparse
import importlib
import os
import resource
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from wayside.pipeline import cli

LIMIT_S = 15.0
IDLE_S = 15.0
MORE_BYTES = 1 << 30
HEAVY = ("evaluate", "evidence.write", "exporting.export", "fitting.command",
         "fleet.running", "fleet.changes", "information", "joining", "labelling.page",
         "report_figures.command", "roc.command", "route_file", "run")  # fmt: skip
PATH = "PATH"
DEMO = "recordings/demo.mcap"
SHORT = ["--until", "0.9s", "--workers", "1"]
BOARD = ["--board", "9x6", "-o", "{scratch}/new.yaml"]

INPUTS: dict[str, list[str]] = {
    "run LOG": ["run", PATH, "-o", "{scratch}/new"],
    "run LOG --resume": ["run", PATH, "-o", "{scratch}/new", "--resume"],
    "run --settings": ["run", DEMO, "-o", "{scratch}/new", "--settings", PATH],
    "run --calibration": ["run", DEMO, "-o", "{scratch}/new", "--calibration", PATH],
    "run --detector": ["run", DEMO, "-o", "{scratch}/new", "--detector", PATH],
    "run --detections": ["run", DEMO, "-o", "{scratch}/new", "--detections", PATH],
    "run --classes": ["run", DEMO, "-o", "{scratch}/new", "--detections", "{scratch}/boxes.json",
                      "--classes", PATH],
    "run --models": ["run", DEMO, "-o", "{scratch}/new", "--models", PATH],
    "run --routes": ["run", DEMO, "-o", "{scratch}/new", "--routes", PATH],
    "replay LOG": ["replay", PATH, "--connect", "127.0.0.1:9"],
    "info LOG": ["info", PATH],
    "import IMAGES": ["import", PATH, "--calibration", "{scratch}/camera.yaml",
                      "--spacing", "26.4ft", "-o", "{scratch}/new.mcap"],
    "join PARTS": ["join", PATH, "-o", "{scratch}/new.mcap"],
    "calibrate LOG": ["calibrate", PATH, "-o", "{scratch}/new.yaml"],
    "calibrate BOARDS": ["calibrate", PATH, *BOARD],
    "evaluate OUT": ["evaluate", PATH, "--truth", "recordings/demo.truth.json"],
    "evaluate --truth": ["evaluate", "{out}", "--truth", PATH],
    "evidence OUT": ["evidence", PATH, "-o", "{scratch}/sheets"],
    "evidence --log": ["evidence", "{out}", "-o", "{scratch}/sheets", "--log", PATH],
    "export OUT": ["export", PATH, "-o", "{scratch}/new.csv"],
    "export --review": ["export", "{out}", "-o", "{scratch}/new.csv", "--review", PATH],
    "label OUT": ["label", PATH, "-o", "{scratch}/page"],
    "label LABELS": ["label", "{out}", PATH, "-o", "{scratch}/labels.parquet"],
    "view OUT": ["view", PATH, "--serve"],
    "picture OUT": ["picture", PATH, "--frame", "1", "-o", "{scratch}/new.png"],
    "fit LABELS": ["fit", PATH, "--images", DEMO, "-o", "{scratch}/models"],
    "fit --images": ["fit", "recordings/demo.truth.json", "--images", PATH,
                     "-o", "{scratch}/models"],
    "roc LOG": ["roc", PATH, "--truth", "recordings/demo.truth.json", "-o", "{scratch}/roc"],
    "report-figures LOG": ["report-figures", PATH, "-o", "{scratch}/figures"],
    "fleet LOGS": ["fleet", "run", PATH, "-o", "{scratch}/inventory"],
    "query INVENTORY": ["query", PATH, "FROM logs"],
    "changes INVENTORY": ["changes", PATH, "--before", "2024", "--after", "2025",
                          "-o", "{scratch}/changes.html"],
}  # fmt: skip
CAMERA = """image_width: 1600
image_height: 1200
camera_matrix: {rows: 3, cols: 3, data: [1398.0, 0, 796.0, 0, 1398.0, 602.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""
OUTPUTS: dict[str, list[str]] = {
    "run -o": ["run", DEMO, "-o", PATH, *SHORT],
    "import -o": ["import", "{scratch}/images", "--calibration", "{scratch}/camera.yaml",
                  "--spacing", "26.4ft", "-o", PATH],
    "join -o": ["join", DEMO, "-o", PATH],
    "evaluate --json": ["evaluate", "{out}", "--truth", "recordings/demo.truth.json", "--json", PATH],
    "evidence -o": ["evidence", "{out}", "-o", PATH],
    "export -o": ["export", "{out}", "-f", "csv", "-o", PATH],
    "label -o": ["label", "{out}", "-o", PATH],
    "fleet -o": ["fleet", "run", "{scratch}/nothing", "-o", PATH],
}  # fmt: skip


TO_STREAMS = ("import -o", "join -o", "evaluate --json", "export -o")
"""Outputs that may be a pipe or a device."""


@dataclass(frozen=True, slots=True)
class Ending:
    """How a command ended: its status (None: it did not), what it said, and its processor time."""

    status: int | None
    said: str
    seconds: float
    elsewhere: bool = False

    @property
    def kind(self) -> str:
        """`refused`, `elsewhere` (for something else than the path), `done` or `wrong`."""
        if self.elsewhere:
            return "elsewhere"
        if self.status is None or "Traceback" in self.said:
            return "wrong"
        return {0: "done", 4: "done", 2: "refused", 3: "refused", 5: "refused"}.get(
            self.status, "wrong"
        )


def odd_paths(folder: Path, ending: str) -> Iterator[tuple[str, str]]:
    """What stands there, and its path; `ending` is that of the names."""
    made = {name: folder / f"{name}{ending}" for name in ("folder", "empty", "pipe", "link")}
    made["folder"].mkdir()
    made["empty"].touch()
    os.mkfifo(made["pipe"])
    made["link"].symlink_to(made["link"].name)
    yield "not there", str(folder / f"absent{ending}")
    yield "a name of 5000 characters", str(folder / ("x" * 5000 + ending))
    yield "a path of 5000 characters", str(folder / ("x/" * 2500 + f"x{ending}"))
    yield (
        "a name that is no UTF-8",
        os.fsdecode(os.fsencode(folder) + b"/\xff\xfe" + ending.encode()),
    )
    yield "a folder", str(made["folder"])
    yield "an empty file", str(made["empty"])
    yield "below a file", str(made["empty"] / f"x{ending}")
    yield "a pipe", str(made["pipe"])
    yield "a device", "/dev/zero"
    yield "a device without room", "/dev/full"
    with socket.socket(socket.AF_UNIX) as unix:
        at = os.getcwd()
        os.chdir(folder)  # the path of a socket may be 108 bytes long
        unix.bind(f"socket{ending}")
        os.chdir(at)
        yield "a socket", str(folder / f"socket{ending}")
    yield "a link to itself", str(made["link"])
    yield "an empty name", ""


def give(words: list[str], said: Path) -> Ending:
    """Give `wayside` these words in a process of its own."""
    child = os.fork()
    if not child:
        os.setsid()
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        room = pages * os.sysconf("SC_PAGE_SIZE") + MORE_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (room, room))
        opened = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, 0), os.dup2(nowhere, 1), os.dup2(opened, 2)
        sys.argv[1:] = words
        try:
            cli.main()
        except SystemExit as end:
            os._exit(int(end.code or 0))
        except BaseException:
            import traceback

            os.write(2, traceback.format_exc().encode("utf-8", "backslashreplace"))
        os._exit(99)
    waits_since, before = time.monotonic(), -1.0
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            code = os.waitstatus_to_exitcode(status)
            return Ending(code, said.read_text("utf-8", "replace"), before)
        state, seconds = activity(child)
        if seconds > before or state == "R":  # a machine with other work may leave it no time
            waits_since, before = time.monotonic(), seconds
        if time.monotonic() > waits_since + IDLE_S or seconds > LIMIT_S:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return Ending(None, said.read_text("utf-8", "replace"), seconds)
        time.sleep(0.01)


def activity(process: int) -> tuple[str, float]:
    """State of a process as the system calls it, and its processor time, seconds."""
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return words[0], (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def tried(name: str, what: str, path: str, result: Path) -> Ending:
    """Give the command of a name the path."""
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "boxes.json").write_text("[]")
        (Path(scratch) / "camera.yaml").write_text(CAMERA)
        (Path(scratch) / "images").mkdir()
        for number in range(2):
            pixels = np.full((1200, 1600, 3), number, np.uint8)
            cv2.imwrite(str(Path(scratch) / "images" / f"{number}.jpg"), pixels)
        words = (INPUTS | OUTPUTS)[name]
        filled = [
            path if word == PATH else word.format(scratch=scratch, out=result) for word in words
        ]
        if words[:2] == ["run", DEMO] and SHORT[0] not in words:
            filled += SHORT  # some paths leave the run as it is
        end = give(filled, Path(scratch) / "said")
    if end.kind == "refused" and path[:30] not in end.said:
        end = replace(end, elsewhere=True)
    if end.kind in ("wrong", "elsewhere"):
        last = (end.said.strip().splitlines() or [""])[-1]
        print(f"{name}, {what}: status {end.status}: {last[:300]}", file=sys.stderr, flush=True)
    return end


def main() -> int:
    """Try and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="commands whose name holds this")
    parser.add_argument("--what", nargs="*", default=[""], help="kinds that hold one of these")
    args = parser.parse_args()
    wrong = 0
    for name in HEAVY:  # imported once, before the processes
        importlib.import_module(f"wayside.pipeline.{name}")
    print("| path | tried | refused | elsewhere | done | wrong | slowest, ms of CPU |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as base:
        result = Path(base) / "out"
        with redirect_stdout(sys.stderr):
            cli.app(["run", DEMO, "-o", str(result), *SHORT], standalone_mode=False)
        for name, words in (INPUTS | OUTPUTS).items():
            if args.only not in name:
                continue
            ends = [
                tried(name, what, path, result)
                for what, path in odd_paths(Path(tempfile.mkdtemp(dir=base)), ending_of(words))
                if any(one in what for one in args.what)
                and not (name in TO_STREAMS and what == "a pipe")
            ]  # a pipe waits for a reader, as with every program
            kinds = Counter(end.kind for end in ends)
            wrong += kinds["wrong"]
            counts = " | ".join(str(kinds[k]) for k in ("refused", "elsewhere", "done", "wrong"))
            print(
                f"| {name} | {len(ends)} | {counts} | "
                f"{1e3 * max((end.seconds for end in ends), default=0):.0f} |",
                flush=True,
            )
    return 1 if wrong else 0


def ending_of(words: list[str]) -> str:
    """How the name of a file ends that the command reads by its name."""
    before = words[words.index(PATH) - 1]
    return {"--settings": ".toml", "--detections": ".parquet", "join": ".bag"}.get(before, "")


if __name__ == "__main__":
    sys.exit(main())
