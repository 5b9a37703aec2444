"""Attempts to read changed inputs, in a process with limits, and random changes of bytes, JSON and tables."""

import io
import json
import math
import os
import random
import resource
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any, TextIO

import pyarrow as pa
import pyarrow.parquet as pq

from wayside.schemas.errors import WaysideError

MEMORY_BYTES, LONGEST_S = 512 << 20, 2.0
"""What an attempt may take beyond the process as it is: memory, and seconds of processor time."""
RIGHT, TOLD, REFUSED, WRONG = "right", "reported", "refused", "wrong"
"""All used, nothing to report; a loss reported and the rest used; ended with a message; a loss without a message."""

Attempt = Callable[[Path, random.Random], str]
"""Reads one input drawn by chance, in a folder of its own; `RIGHT`, `TOLD` or `WRONG`. Who calls it judges errors."""
Json = Any


def judged(attempt: Attempt, folder: Path, rng: random.Random) -> str:
    """The result of one attempt: an outcome, or an exception that is not meant for a person."""
    try:
        return attempt(folder, rng)
    except WaysideError:
        return REFUSED
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:100]


def tried(
    title: str, attempt: Attempt, count: int, seed: int, folder: Path
) -> tuple[Counter[str], float, float]:
    """Outcomes of many attempts in a forked process, the most processor time of one (s), and memory (MB).

    A process that dies is counted with its signal, and a new one goes on behind the attempt that ended it.
    """
    found: Counter[str] = Counter()
    slowest_s = grown_mb = 0.0
    while found.total() < count:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            status = 1
            try:
                os.close(reading)
                with os.fdopen(writing, "w") as report:
                    _attempts(title, attempt, range(found.total(), count), seed, folder, report)
                status = 0
            finally:
                os._exit(status)
        os.close(writing)
        with os.fdopen(reading) as reports:
            for line in reports:
                outcome, seconds, megabytes = json.loads(line)
                found[outcome] += 1
                slowest_s, grown_mb = max(slowest_s, seconds), max(grown_mb, megabytes)
        _, status = os.waitpid(child, 0)
        if status and found.total() < count:
            killed = os.WIFSIGNALED(status)
            found[f"signal {os.WTERMSIG(status)}" if killed else f"exit {status}"] += 1
    return found, slowest_s, grown_mb


def _attempts(
    title: str, attempt: Attempt, numbers: range, seed: int, folder: Path, report: TextIO
) -> None:
    own = Path(tempfile.mkdtemp(dir=folder))
    judged(attempt, own, random.Random(0))  # imports and compiles
    before = _resident_mb()
    limit_memory(MEMORY_BYTES)
    for number in numbers:
        started = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S)  # CPU time; the signal ends the process
        outcome = judged(attempt, own, random.Random(f"{seed} {title} {number}"))
        signal.setitimer(signal.ITIMER_PROF, 0)
        spent_s, grown_mb = time.process_time() - started, _resident_mb() - before
        report.write(json.dumps((outcome, spent_s, grown_mb)) + "\n")
        report.flush()


def limit_memory(more_bytes: int) -> None:
    """Let this process take so much beyond what it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + more_bytes
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _resident_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def changed_bytes(content: bytes, rng: random.Random) -> bytes:
    """One to six edits: bits flipped, runs set, cut out, inserted or doubled."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 6)):
        at, run = rng.randrange(len(data)), rng.choice((1, 1, 4, 8, rng.randrange(1, 400)))
        edit = rng.randrange(6)
        if edit == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif edit == 1:
            data[at : at + run] = bytes([rng.choice((0, 255, rng.randrange(256)))]) * run
        elif edit == 2:
            del data[at : at + run]
        elif edit == 3:
            data[at:at] = rng.randbytes(run)
        elif edit == 4:
            data[at:at] = data[at : at + run]
        else:
            data[at : at + 8] = rng.choice((0, 2**31, 2**40, 2**63, 45)).to_bytes(8, "little")
        if len(data) < 2:
            break
    return bytes(data)


ODD: tuple[Json, ...] = (
    None, True, -1, 0, 2**31, 2**64, -(2**40), 1e-300, 1e300, math.nan, math.inf,
    "", "x", "../..", "\0", [], {}, [[]], [1],
)  # fmt: skip
ODD_COLUMNS: "tuple[pa.Array[Any], ...]" = (
    pa.nulls(4),
    pa.array([None, 1, 2, 3]),
    pa.array(["a", "\0", "../..", None]),
    pa.array([float("nan"), float("inf"), -1e300, None]),
    pa.array([b"\xff", b"", None, b"x"]),
    pa.array([[1], [], None, [2, 3]]),
    pa.array([{"a": 1}] * 4),
    pa.array([2**63 - 1, -(2**63), 0, -1]),
    pa.array([True, False, None, True]),
    pa.array([1, 2, 3, 4], pa.timestamp("ns")),
)


def changed_tree(value: Json, rng: random.Random) -> bytes:
    """JSON text with one to four values replaced, removed, repeated or exchanged for odd ones."""
    value = json.loads(json.dumps(value))
    for _ in range(rng.randint(1, 4)):
        places = list(_places(value))
        if not places:
            break
        holder, key = rng.choice(places)
        edit = rng.randrange(4)
        if edit == 0:
            del holder[key]
        elif edit == 1 and isinstance(holder, list):
            holder.insert(key, deepcopy(holder[key]))
        else:
            holder[key] = deepcopy(rng.choice(ODD))
    return json.dumps(value).encode()


def _places(value: Json) -> Iterator[tuple[Json, Any]]:
    """Every holder and key of a tree; of long lists the first values only."""
    if isinstance(value, dict | list):
        for key in list(value)[:50] if isinstance(value, dict) else range(min(len(value), 8)):
            yield value, key
            yield from _places(value[key])


def changed_table(table: pa.Table, rng: random.Random) -> bytes:
    """Parquet of a table with bytes changed, or with columns left out, doubled, without rows or of other content."""
    if rng.random() < 0.7:
        for _ in range(rng.randint(1, 3)):
            at = rng.randrange(table.num_columns)
            name = table.column_names[at]
            edit = rng.randrange(4)
            if edit == 0 and table.num_columns > 1:
                table = table.remove_column(at)
            elif edit == 1:
                table = table.append_column(name, table.column(at))
            elif edit == 2:
                odd = pa.concat_arrays([rng.choice(ODD_COLUMNS)] * 9)
                table = table.set_column(at, name, odd.slice(0, table.num_rows))
            else:
                table = table.slice(0, rng.randrange(table.num_rows + 1))
    stream = io.BytesIO()
    pq.write_table(table, stream)
    content = stream.getvalue()
    return content if rng.random() < 0.5 else changed_bytes(content, rng)
