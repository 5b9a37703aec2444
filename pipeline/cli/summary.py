"""The closing words of a run, for a person."""

import shlex
from collections import Counter
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from wayside.pipeline.code_words import code_of
from wayside.pipeline.files.output_folder import RECORDING
from wayside.pipeline.files.visible_text import counted, visible
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

    `verbose`: also what became of the regions, and the share of each stage in the time.
    """
    rows = result.inventory.sign_rows
    if rows:
        console.print(sign_table(rows[:_MOST_SIGNS], console.width))
    if len(rows) > _MOST_SIGNS:
        console.print(f"... and {len(rows) - _MOST_SIGNS} more in signs.parquet")
    console.print(_signs(rows))
    console.print(_images(result))
    if result.boxes is not None:
        console.print(result.boxes.words)
    if verbose:
        regions = _counts(result.inventory.verdicts)
        console.print(f"regions by verdict: {regions}" if regions else "no regions")
        total = sum(result.stage_seconds.values()) or 1.0
        shares = (f"{name} {100 * s / total:.0f} %" for name, s in result.stage_seconds.items())
        console.print(f"processor time {total:.1f} s: {', '.join(shares)}")
    said = [("note", words) for words in result.notes] + [("lost", part) for part in result.lost]
    said += [("viewer", fault) for fault in result.view_faults]
    if kept and result.recorded is False:
        said.append(("not written", f"{RECORDING}; the tables are complete"))
    for what, words in said:
        console.print(f"[yellow]{what}:[/yellow] {plain(words)}", highlight=False)
    if not kept:
        return
    tables = (f"{name} ({counted(count, 'row')})" for name, count in result.inventory.rows.items())
    files = [*tables, "run.json", *[RECORDING] * bool(result.recorded)]
    console.print(f"written to {plain(result.folder)}: {', '.join(files)}")
    if result.older:
        pages = sum(name.startswith("evidence/") for name in result.older)
        named = [name for name in result.older if not name.startswith("evidence/")]
        words = ", ".join([*named, f"evidence ({pages} pages)"] if pages else named)
        console.print(f"from an earlier result, write them again: {plain(words)}")
    folder = plain(shlex.quote(str(result.folder)))
    further = [f"wayside view {folder} (every step)"] * bool(result.recorded)
    if rows:
        further += [
            f"wayside evidence {folder} (a page of each sign, to check and correct)",
            f"wayside export {folder} -f csv (for other programs)",
        ]
    if further:
        console.print(f"next: {'; '.join(further)}")


def _signs(rows: list[dict[str, Any]]) -> str:
    """How many signs, by colour, and how many rows of other kinds."""
    signs = [row for row in rows if row["status"] == "sign"]
    colors = Counter(str(row["color"] or "unknown colour").replace("_", " ") for row in signs)
    others = Counter(row["status"] for row in rows if row["status"] != "sign")
    words = f"[bold]{counted(len(signs), 'sign')}[/bold]"
    if colors:
        words += f": {_counts(dict(colors.most_common()))}"
    return words + "".join(f"; {count} {status}" for status, count in sorted(others.items()))


def _images(result: RunResult) -> str:
    total = sum(result.frames.values())
    reasons = "".join(f", {v} {k}" for k, v in sorted(result.frames.items()) if k != USED)
    rate = total / result.wall_seconds if result.wall_seconds else 0.0
    return (
        f"{counted(total, 'image')} read: {result.frames.get(USED, 0)} used{reasons}; "
        f"{result.wall_seconds:.1f} s, {rate:.1f} images/s"
    )


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items())


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
