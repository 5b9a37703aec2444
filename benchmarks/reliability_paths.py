"""Odd names and odd kinds of files in every place where a command takes a path: what becomes of them.

    PYTHONPATH=. .venv/bin/python benchmarks/reliability_paths.py [--only NAME]

Every command is given, in turn for each of its paths: a name that is not there, one too long for the system, one with
bytes that are no UTF-8, a folder (where a file is wanted), a file (where a folder is wanted), an empty file, a pipe
nobody writes to, a device, a socket, a link to itself, and a folder that may not be entered. Refused: ended with words
and the exit status of a wrong argument, input or output. Done: ended with status 0 or 4, as an output may be of a
name that is no UTF-8. Wrong: a traceback, another status, or no end within fifteen seconds. Prints a table and every
wrong case; ends with status 1 where there is one.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from wayside.pipeline import cli

LIMIT_S = 15.0
MORE_BYTES = 1 << 30
PATH = "PATH"
DEMO = "recordings/demo.mcap"
SHORT = ["--until", "0.9s", "--set", "models.network=", "--workers", "1"]
BOARD = ["--board", "9x6", "-o", "{scratch}/camera.yaml"]

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
    "import IMAGES": ["import", PATH, "--spacing", "26.4ft", "-o", "{scratch}/new.mcap"],
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
    "fit --images": ["fit", "{scratch}/labels.json", "--images", PATH, "-o", "{scratch}/models"],
    "roc LABELS": ["roc", PATH, "-o", "{scratch}/roc"],
    "report-figures LOG": ["report-figures", PATH, "-o", "{scratch}/figures"],
    "fleet LOGS": ["fleet", "run", PATH, "-o", "{scratch}/inventory"],
    "query INVENTORY": ["query", PATH, "FROM logs"],
    "changes INVENTORY": ["changes", PATH, "--before", "2024", "--after", "2025",
                          "-o", "{scratch}/changes.html"],
}  # fmt: skip
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


@dataclass(frozen=True, slots=True)
class Ending:
    """How a command ended: its status (None: it did not), what it said, and after how long."""

    status: int | None
    said: str
    seconds: float

    @property
    def kind(self) -> str:
        """`refused`, `done` or `wrong`."""
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
    started = time.monotonic()
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
    while time.monotonic() < started + LIMIT_S:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            text = said.read_text("utf-8", "replace")
            return Ending(os.waitstatus_to_exitcode(status), text, time.monotonic() - started)
        time.sleep(0.01)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return Ending(None, said.read_text("utf-8", "replace"), LIMIT_S)


def main() -> int:
    """Try and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    found: dict[str, Counter[str]] = {}
    slowest: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as base:
        result = Path(base) / "out"
        cli.app(["run", DEMO, "-o", str(result), *SHORT], standalone_mode=False)
        for name, words in (INPUTS | OUTPUTS).items():
            if args.only not in name:
                continue
            count = found.setdefault(name, Counter())
            last = words[words.index(PATH) - 1]
            ending = {"--settings": ".toml", "--detections": ".parquet", "join": ".bag"}.get(
                last, ""
            )
            folder = Path(tempfile.mkdtemp(dir=base))
            for what, path in odd_paths(folder, ending):
                if (
                    name in OUTPUTS
                    and what in ("a pipe",)
                    and "evaluate export".find(words[0]) >= 0
                ):
                    continue  # waits for a reader, as every program does
                with tempfile.TemporaryDirectory() as scratch:
                    (Path(scratch) / "boxes.json").write_text("[]")
                    (Path(scratch) / "labels.json").write_text("{}")
                    filled = [
                        path if word == PATH else word.format(scratch=scratch, out=result)
                        for word in words
                    ]
                    if words[:2] == ["run", DEMO] and SHORT[0] not in words:
                        filled += SHORT  # some paths leave the run as it is
                    end = give(filled, Path(scratch) / "said")
                    count[end.kind] += 1
                    slowest[name] = max(slowest[name], round(1e3 * end.seconds))
                    if end.kind == "wrong" or args.only:
                        lines = end.said.strip().splitlines() or [""]
                        shown = lines[-1][:300]
                        print(
                            f"{name}, {what}: {end.kind}, status {end.status}: {shown}",
                            file=sys.stderr,
                            flush=True,
                        )
    print("| path | tried | refused | done | wrong | slowest, ms |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for name, count in found.items():
        print(
            f"| {name} | {count.total()} | {count['refused']} | {count['done']} | {count['wrong']} | {slowest[name]} |"
        )
    return 1 if any(count["wrong"] for count in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
