"""Shared by the measuring programs: paths, runs of wayside, tables and the line of versions."""

import resource
import subprocess
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS, DEMO = ROOT / "benchmarks", ROOT / "recordings" / "demo.mcap"
DRIVES, RESULTS = ROOT / ".cache" / "drives", ROOT / ".cache" / "accept"
REAL_DRIVES = ROOT.parent / "shared" / "data" / "real"
"""Real drives are not part of the repository."""
WAYSIDE = str(Path(sys.executable).with_name("wayside"))


def render(names: Iterable[str], jobs: int = 2) -> None:
    """Make the rendered drives that do not exist yet."""
    specs = [f"recordings/drives/specs/{name}.toml" for name in names]
    if specs:
        command = [sys.executable, "-m", "recordings.drives", *specs, "-o", str(DRIVES)]
        subprocess.run([*command, "--missing", "--jobs", str(jobs)], cwd=ROOT, check=True)


def run_wayside(*words: object, check: bool = False) -> subprocess.CompletedProcess[str]:
    """Run `wayside` as a user does; ends the program with its last words where it must succeed and fails."""
    command = [WAYSIDE, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    if check and done.returncode != 0:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done


def processor_seconds() -> float:
    """Processor time of all processes so far that this one started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def versions() -> str:
    """The packages that the figures depend on."""
    names = ("wayside", "numpy", "scipy", "opencv-python-headless", "numba")
    return "Versions: " + ", ".join(f"{name} {version(name)}" for name in names) + "."


def row(cells: Iterable[object]) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


def head(names: Sequence[str], words: int = 1) -> str:
    """Two lines: the names of columns, of which the first few hold words and the others numbers."""
    return f"{row(names)}\n| {'--- | ' * words}{'---: | ' * (len(names) - words)}".rstrip()


def table(names: Sequence[str], rows: Iterable[Iterable[object]], words: int = 1) -> list[str]:
    """Lines of a Markdown table."""
    return [*head(names, words).splitlines(), *map(row, rows)]


def print_table(names: Sequence[str], rows: Iterable[Iterable[object]], words: int = 1) -> None:
    """Print a table, each row as soon as it is there."""
    print(head(names, words), flush=True)
    for cells in rows:
        print(row(cells), flush=True)
