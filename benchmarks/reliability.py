"""What happens with faults of clocks and positions, changed inputs, kills, full disks and odd paths.

    PYTHONPATH=. .venv/bin/python benchmarks/reliability.py QUESTION [--only NAME ...] [--count N] [--seed S]

Drives: the demo drive with faults of clocks, order, positions and images written into its log. Inputs: all that is
read, changed at random or cut off, and inputs that must be refused, N of each kind. Kills: runs that are killed, half
of them at the first change of the result. Resumed: the same with --resume, started again. Disks: runs on N disks of
growing size, which only root can mount. Paths: odd names and kinds of files wherever a command takes a path.

Prints a table and ends with status 1 where anything went wrong. `reliability.md` says what counts as wrong.
"""

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import reliability_drives as drives
import reliability_inputs as inputs
import reliability_machine as machine
import reliability_paths as paths
from common import head, row

Rows = Iterator[tuple[list[str], bool]]
QUESTIONS: dict[str, tuple[Sequence[str], int, Callable[[Sequence[str], int, int], Rows]]] = {
    "drives": (drives.HEADS, 1, drives.rows),
    "inputs": (inputs.HEADS, 30, inputs.rows),
    "kills": (machine.KILL_HEADS, 40, partial(machine.kill_rows, machine.NEW, ("old", "new"))),
    "resumed": (machine.KILL_HEADS, 40, partial(machine.kill_rows, machine.RESUMED, ("new",))),
    "disks": (machine.DISK_HEADS, 9, machine.disk_rows),
    "paths": (paths.HEADS, 1, paths.rows),
}
"""Columns, count, and what makes rows of names to choose by, a count and a seed."""


def main() -> int:
    """Try and print."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("question", choices=QUESTIONS)
    parser.add_argument("--only", nargs="+", default=[""], help="rows whose name contains this")
    parser.add_argument("--count", type=int, help="how many of each")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    heads, count, rows = QUESTIONS[given.question]
    print(head(heads), flush=True)
    status = 0
    for cells, good in rows(given.only, given.count or count, given.seed):
        print(row(cells), flush=True)
        status = status if good else 1
    return status


if __name__ == "__main__":
    sys.exit(main())
