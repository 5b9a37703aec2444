"""Odd names and odd kinds of files in every place where a command takes a path.

Refused: ended with words that name the path, and the exit status of a wrong argument, input or output. Elsewhere:
likewise, for something else. Done: ended with status 0 or 4, as an output may have a name that is not UTF-8. Wrong: a
traceback, another status, or fifteen seconds without any work or of work.
"""

import importlib
import os
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from common import DEMO, ROOT, run_wayside
from reliability_machine import forked, spent
from small_inputs import CAMERAS

HEADS = ("path", "tried", "refused", "elsewhere", "done", "wrong", "slowest, ms of CPU")
LIMIT_S, IDLE_S, MORE_BYTES = 15.0, 15.0, 1 << 30
HEAVY = """evaluation.compare evidence.write exporting.export fitting.command fleet.running fleet.changes
logs.information logs.joining labelling.page report_figures.command roc.command files.route_file running.run""".split()
SHORT = ["--until", "0.9s", "--workers", "1"]
TRUTH = ROOT / "recordings" / "demo.truth.json"
IMPORT = "--calibration @/camera.yaml --spacing 26.4ft"
COMMANDS = {
    "run LOG": "run PATH -o @/new",
    "run LOG --resume": "run PATH -o @/new --resume",
    "run --settings": "run DEMO -o @/new --settings PATH",
    "run --calibration": "run DEMO -o @/new --calibration PATH",
    "run --detector": "run DEMO -o @/new --detector PATH",
    "run --detections": "run DEMO -o @/new --detections PATH",
    "run --classes": "run DEMO -o @/new --detections @/boxes.json --classes PATH",
    "run --models": "run DEMO -o @/new --models PATH",
    "run --routes": "run DEMO -o @/new --routes PATH",
    "replay LOG": "replay PATH --connect 127.0.0.1:9",
    "info LOG": "info PATH",
    "import IMAGES": f"import PATH {IMPORT} -o @/new.mcap",
    "join PARTS": "join PATH -o @/new.mcap",
    "calibrate LOG": "calibrate PATH -o @/new.yaml",
    "calibrate BOARDS": "calibrate PATH --board 9x6 -o @/new.yaml",
    "evaluate OUT": "evaluate PATH --truth TRUTH",
    "evaluate --truth": "evaluate OUT --truth PATH",
    "evidence OUT": "evidence PATH -o @/sheets",
    "evidence --log": "evidence OUT -o @/sheets --log PATH",
    "export OUT": "export PATH -o @/new.csv",
    "export --review": "export OUT -o @/new.csv --review PATH",
    "label OUT": "label PATH -o @/page",
    "label LABELS": "label OUT PATH -o @/labels.parquet",
    "view OUT": "view PATH --serve",
    "picture OUT": "picture PATH --frame 1 -o @/new.png",
    "fit LABELS": "fit PATH --images DEMO -o @/models",
    "fit --images": "fit TRUTH --images PATH -o @/models",
    "roc LOG": "roc PATH --truth TRUTH -o @/roc",
    "report-figures LOG": "report-figures PATH -o @/figures",
    "fleet LOGS": "fleet run PATH -o @/inventory",
    "query INVENTORY": "query PATH FROM_logs",
    "changes INVENTORY": "changes PATH --before 2024 --after 2025 -o @/changes.html",
    "run -o": "run DEMO -o PATH",
    "import -o": f"import @/images {IMPORT} -o PATH",
    "join -o": "join DEMO -o PATH",
    "evaluate --json": "evaluate OUT --truth TRUTH --json PATH",
    "evidence -o": "evidence OUT -o PATH",
    "export -o": "export OUT -f csv -o PATH",
    "label -o": "label OUT -o PATH",
    "fleet -o": "fleet run @/nothing -o PATH",
}
"""Commands with PATH in the place of the path; @: a folder to write in."""
TO_STREAMS = ("import -o", "join -o", "evaluate --json", "export -o")
"""Outputs that may be a pipe, which waits for a reader as with every program."""
ENDINGS = {"run --settings": ".toml", "run --detections": ".parquet", "join PARTS": ".bag"}
"""How the name of a file ends that the command reads by its name."""
STATUSES = {0: "done", 4: "done", 2: "refused", 3: "refused", 5: "refused"}


def rows(only: Sequence[str], _: int, __: int) -> Iterator[tuple[list[str], bool]]:
    """A row for each command whose name contains one of `only`, and whether nothing went wrong."""
    for name in HEAVY:  # imported once, before the processes
        importlib.import_module(f"wayside.pipeline.{name}")
    with tempfile.TemporaryDirectory() as base:
        result = Path(base) / "out"
        run_wayside("run", DEMO, "-o", result, *SHORT, check=True)
        for name in COMMANDS:
            if not any(part in name for part in only):
                continue
            folder = Path(tempfile.mkdtemp(dir=base))
            ends = [
                tried(name, what, path, result)
                for what, path in odd_paths(folder, ENDINGS.get(name, ""))
                if what != "a pipe" or name not in TO_STREAMS
            ]
            kinds = Counter(kind for kind, _ in ends)
            cells = [kinds[kind] for kind in ("refused", "elsewhere", "done", "wrong")]
            slowest = f"{1e3 * max(seconds for _, seconds in ends):.0f}"
            yield [name, str(len(ends)), *map(str, cells), slowest], not kinds["wrong"]


def odd_paths(folder: Path, ending: str) -> Iterator[tuple[str, str]]:
    """What the path is, and the path. Names end with `ending`."""
    made = {name: folder / f"{name}{ending}" for name in ("folder", "empty", "pipe", "link")}
    made["folder"].mkdir()
    made["empty"].touch()
    os.mkfifo(made["pipe"])
    made["link"].symlink_to(made["link"].name)
    no_text = os.fsdecode(os.fsencode(folder) + b"/\xff\xfe" + ending.encode())
    with socket.socket(socket.AF_UNIX) as unix:
        at = os.getcwd()
        os.chdir(folder)  # the path of a socket may be 108 bytes long
        unix.bind(f"socket{ending}")
        os.chdir(at)
        yield from {
            "not there": str(folder / f"absent{ending}"),
            "a name of 5000 characters": str(folder / ("x" * 5000 + ending)),
            "a path of 5000 characters": str(folder / ("x/" * 2500 + f"x{ending}")),
            "a name that is not UTF-8": no_text,
            "a folder": str(made["folder"]),
            "an empty file": str(made["empty"]),
            "below a file": str(made["empty"] / f"x{ending}"),
            "a pipe": str(made["pipe"]),
            "a device": "/dev/zero",
            "a device without room": "/dev/full",
            "a socket": str(folder / f"socket{ending}"),
            "a link to itself": str(made["link"]),
            "an empty name": "",
        }.items()


def tried(name: str, what: str, path: str, result: Path) -> tuple[str, float]:
    """Give the command of a name the path; how it ended, and its processor time, seconds."""
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "boxes.json").write_text("[]")
        (Path(scratch) / "camera.yaml").write_bytes(CAMERAS[0])
        (Path(scratch) / "images").mkdir()
        for number in range(2):
            pixels = np.full((480, 640, 3), number, np.uint8)
            cv2.imwrite(str(Path(scratch) / "images" / f"{number}.jpg"), pixels)
        known = {"PATH": path, "DEMO": str(DEMO), "TRUTH": str(TRUTH), "OUT": str(result)}
        known["FROM_logs"] = "FROM logs"
        words = [known.get(w, w.replace("@", scratch)) for w in COMMANDS[name].split()]
        words += SHORT if COMMANDS[name].startswith("run DEMO") else []
        status, said, seconds = given(words, Path(scratch) / "said")
    kind = "wrong" if status is None or "Traceback" in said else STATUSES.get(status, "wrong")
    if kind == "refused" and path[:30] not in said:
        kind = "elsewhere"
    if kind in ("wrong", "elsewhere"):
        last = (said.strip().splitlines() or [""])[-1]
        print(f"{name}, {what}: status {status}: {last[:300]}", file=sys.stderr, flush=True)
    return kind, seconds


def given(words: list[str], said: Path) -> tuple[int | None, str, float]:
    """Give `wayside` these words: exit status (None: it did not end), words on stderr, processor time in seconds."""
    child = forked(words, str(said), MORE_BYTES)
    waits_since, before = time.monotonic(), -1.0
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status), said.read_text("utf-8", "replace"), before
        state, seconds = spent(child)
        if seconds > before or state == "R":  # a machine with other work may leave it no time
            waits_since, before = time.monotonic(), seconds
        if time.monotonic() > waits_since + IDLE_S or seconds > LIMIT_S:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None, said.read_text("utf-8", "replace"), seconds
        time.sleep(0.01)
