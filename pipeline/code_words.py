"""The code of a sign in words, as sheets, the index, the viewer and the summary show it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from wayside.schemas.sign_catalogue import SERIES, US, VIENNA, stated
from wayside.schemas.signs import Sign

SYSTEM_WORDS = {US: "MUTCD", VIENNA: "Vienna Convention"}


def code_of(row: Mapping[str, Any]) -> str | None:
    """Code or series of a row of `signs.parquet` with its legend, such as `R2-1 45`. None where neither is known."""
    code = row.get("mutcd") or row.get("vienna")
    return None if not code else " ".join(filter(None, (code, row.get("legend"))))


def statement_of(row: Mapping[str, Any]) -> tuple[str, ...]:
    """What a row says of its sign, from the widest, as `stated` has it; only its category where that alone is known."""
    for system, column in ((US, "mutcd"), (VIENNA, "vienna")):
        if row.get(column):
            return stated(system, row[column], row.get("legend"))
    return tuple(filter(None, (row.get("category"),)))


def system_words(row: Mapping[str, Any]) -> str:
    """The system that the code of a row is of."""
    return SYSTEM_WORDS[US if row.get("mutcd") else VIENNA]


def series_words(row: Mapping[str, Any]) -> str | None:
    """Meaning of the series that is stated instead of a code; None with a code, or without either."""
    series = SERIES[US if row.get("mutcd") else VIENNA].get(code_of(row) or "")
    return None if series is None else series[0]


def nominal_words(row: Mapping[str, Any]) -> str | None:
    """The standard size in inches of a US sign, in millimetres of a European one, or None; of diamonds also across."""
    width, height = row.get("nominal_width_in"), row.get("nominal_height_in")
    if width is None or height is None:
        return None
    scale, unit = (25.4, "mm") if row.get("vienna") else (1.0, "in")
    across = f" along its sides, {width * scale * 2**0.5:.0f} {unit} across"
    size = " x ".join(f"{side * scale:{'.0f' if scale > 1 else 'g'}}" for side in (width, height))
    return f"{size} {unit}{across if row.get('shape') == 'diamond' else ''}"


def system_notes(signs: Sequence[Sign], settled: float) -> list[str]:
    """Words for a drive whose signs do not determine their system, so that no code can be stated."""
    if not signs or not 1 - settled < signs[0].us_probability < settled:
        return []
    return [
        f"it is unclear whether the signs are of the US system (probability {signs[0].us_probability:.2f}), so "
        "no code is stated; choose with --set codes.system=us or vienna"
    ]


def posts_words(
    row: Mapping[str, Any], size: Callable[[float], str] = "{:.2f} m".format
) -> tuple[str, str]:
    """Kind and number of a row of `posts.parquet`, and the width of a post with its error, in words of `size`."""
    kind, number, wide = row["kind"].replace("_", " "), row["number"], row["width_m"]
    counted = "" if number is None else f", {number} post" + "s" * (number > 1)
    width = "" if wide is None else f"{size(wide)} ± {size(row['sigma_width_m'])} wide"
    return kind + counted, width
