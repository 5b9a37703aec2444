"""The closing words of a run, for a person."""

from __future__ import annotations

import shlex
from collections import Counter
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from wayside.pipeline.code_words import code_of
from wayside.pipeline.files.output_folder import RECORDING
from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.running.run import RunResult
from wayside.schemas.frame import USED

_MOST_SIGNS = 40
_WIDE = 100
_FEWER_NUMBERS = {"station_m": "station m", "lateral_m": "right m", "sigma_along_m": "±along"}
_NUMBERS = {
    "station_m": "station m",
    "lateral_m": "right m",
    "up_m": "up m",
    "panel_width_m": "width m",
    "panel_height_m": "height m",
    "sigma_along_m": "±along m",
}
"""Columns of numbers, and their headings."""


def print_summary(
    result: RunResult, console: Console, *, kept: bool = True, verbose: bool = False
) -> None:
    """Signs found, images used and not used; where the files are `kept`, and what to type next.

    verbose: also what became of the regions, and the share of each stage in the time.
    """
    rows = result.inventory.sign_rows
    signs = [row for row in rows if row["status"] == "sign"]
    if rows:
        console.print(sign_table(rows[:_MOST_SIGNS], console.width))
    if len(rows) > _MOST_SIGNS:
        console.print(f"... and {len(rows) - _MOST_SIGNS} more in signs.parquet")
    console.print(f"[bold]{len(signs)} signs[/bold]{_by_color(signs)}{_others(rows)}")
    console.print(_images(result))
    if result.boxes is not None:
        console.print(result.boxes.words)
    if verbose:
        console.print(_regions(result.inventory.verdicts))
        console.print(_times(result))
    for note in result.notes:
        console.print(f"[yellow]note:[/yellow] {plain(note)}", highlight=False)
    for part in result.lost:
        console.print(f"[yellow]lost:[/yellow] {plain(part)}")
    for fault in result.view_faults:
        console.print(f"[yellow]viewer:[/yellow] {plain(fault)}")
    if not kept:
        return
    if result.recorded is False:
        console.print(f"[yellow]not written:[/yellow] {RECORDING}; the tables are whole")
    recorded = bool(result.recorded)
    console.print(
        f"written to {plain(result.folder)}: {_files(result.inventory.rows)}, run.json"
        f"{f', {RECORDING}' if recorded else ''}"
    )
    folder = plain(shlex.quote(str(result.folder)))
    further = [f"wayside view {folder} (every step)"] * recorded
    if rows:
        further += [
            f"wayside evidence {folder} (a page of each sign, to check and correct)",
            f"wayside export {folder} -f csv (for other programs)",
        ]
    if further:
        console.print(f"next: {'; '.join(further)}")


def plain(text: object) -> str:
    """What a log or a name says, as it is: neither markup nor a command to the terminal."""
    return escape(visible(str(text)))


def sign_table(signs: list[dict[str, Any]], width: int = _WIDE) -> Table:
    """One line a sign: its name, place and uncertainty. It has fewer columns where `width` has no room."""
    table = Table(
        box=None, pad_edge=False, padding=(0, 2 if width >= _WIDE else 1, 0, 0), header_style="bold"
    )
    for heading in ("sign", "color", "shape", "code"):
        table.add_column(heading, overflow="fold")
    numbers = dict(_NUMBERS if width >= _WIDE else _FEWER_NUMBERS)
    units = {row["measure_unit"] for row in signs if row.get("measure") is not None}
    if len(units) == 1:
        numbers = {"measure": f"measure {units.pop()}"} | numbers
        del numbers["station_m"]
    for heading in (*numbers.values(), "views", "conf."):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in signs:
        table.add_row(
            plain(row["sign_id"]),
            (row["color"] or "-").replace("_", " "),
            (row["shape"] or "-") + ("" if row["status"] == "sign" else f" ({row['status']})"),
            plain(code_of(row) or "-"),
            *(_number(row.get(name), 3 if name == "measure" else 2) for name in numbers),
            str(row["views"]),
            _number(row["confidence"], 2),
        )
    return table


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _by_color(signs: list[dict[str, Any]]) -> str:
    counts = Counter(str(row["color"] or "unknown colour").replace("_", " ") for row in signs)
    words = ", ".join(f"{count} {color}" for color, count in counts.most_common())
    return f": {words}" if words else ""


def _others(signs: list[dict[str, Any]]) -> str:
    counts = Counter(row["status"] for row in signs if row["status"] != "sign")
    return "".join(f"; {count} {status}" for status, count in sorted(counts.items()))


def _images(result: RunResult) -> str:
    total = sum(result.frames.values())
    reasons = "".join(f", {v} {k}" for k, v in sorted(result.frames.items()) if k != USED)
    rate = total / result.wall_seconds if result.wall_seconds else 0.0
    return (
        f"{total} images read: {result.frames.get(USED, 0)} used{reasons}; "
        f"{result.wall_seconds:.1f} s, {rate:.1f} images/s"
    )


def _regions(verdicts: dict[str, int]) -> str:
    words = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    return f"regions by verdict: {words}" if words else "no regions"


def _times(result: RunResult) -> str:
    total = sum(result.stage_seconds.values()) or 1.0
    words = ", ".join(f"{name} {100 * s / total:.0f} %" for name, s in result.stage_seconds.items())
    return f"processor time {total:.1f} s: {words}"


def _files(rows: dict[str, int]) -> str:
    return ", ".join(f"{name} ({count} rows)" for name, count in rows.items())
