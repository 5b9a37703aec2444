"""The catalogue of sign codes: colour, shape and size of the signs of each code; its rows are in the CSV of this name.

Sources: the tables of sizes of the Manual on Uniform Traffic Control Devices, 11th edition (FHWA, 2023), with sizes
still on roads (edition of 2009, Standard Highway Signs). The page docs/sign_codes.md says what was compared with which
text. Convention on Road Signs and Signals (Vienna 1968), annex 1: it states least sizes, here are the common ones.

The size of a diamond is the side of its square, and of a triangle its side twice. A pennant has its long side and its
base, a crossbuck the length and width of a blade.
"""

import csv
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

US, VIENNA = "us", "vienna"
SYSTEMS = (US, VIENNA)

INCH_M, MM_M = 0.0254, 0.001

SERIES: dict[str, dict[str, tuple[str, str | None, str]]] = {
    US: {
        "R": ("regulatory", None, "regulatory"),
        "W": ("warning", None, "warning"),
        "S": ("school", None, "school"),
        "TTC": ("temporary traffic control", None, "temporary"),
        "OM": ("object marker", None, "marker"),
        "M": ("route marker", None, "guide"),
        "D/E/I": ("guide", None, "guide"),
        "D": ("guide of conventional roads", "D/E/I", "guide"),
        "E": ("guide of freeways and expressways", "D/E/I", "guide"),
    },
    VIENNA: {
        "A": ("danger warning", None, "warning"),
        "B": ("priority", None, "regulatory"),
        "C": ("prohibitory or restrictive", None, "regulatory"),
        "D": ("mandatory", None, "regulatory"),
        "E": ("special regulation", None, "regulatory"),
        "G": ("direction, position or indication", None, "guide"),
        "H": ("additional panel", None, "plate"),
    },
}
"""Series of each system: what it means, the group that it is stated as where it is not settled itself, its category.

Categories: chapters 2B to 2M, 6 and 7 of the MUTCD; article 5 of the Vienna Convention."""
CATEGORIES = tuple(dict.fromkeys(one for system in SERIES.values() for *_, one in system.values()))

Size = tuple[float, float]


@dataclass(frozen=True, slots=True)
class CatalogueSign:
    """The signs of one code, or the rest of a series (code = series)."""

    code: str
    """Of the sign, or the series."""
    series: str
    """That it belongs to."""
    colors: tuple[str, ...]
    """Any of these classes."""
    shapes: tuple[str, ...]
    """Any of these classes."""
    sizes: tuple[Size, ...] = ()
    """Nominal width and height, inches or (Vienna) millimetres; see above."""
    limits: tuple[Size, Size] | None = None
    """Least and largest width and height, where the size is free."""
    faces: tuple[str, ...] = ()
    """Classes of the face classifier that show it, the legend after a space."""
    weight: float = 1.0
    """How common it is: a judgement."""


def _sizes(text: str) -> tuple[Size, ...]:
    pairs = (one.split("x") for one in text.split())
    return tuple((float(width), float(height)) for width, height in pairs)


def _sign(row: dict[str, str]) -> CatalogueSign:
    limits = _sizes(row["limits"])
    return CatalogueSign(
        row["code"],
        row["series"],
        tuple(row["colors"].split("/")),
        tuple(row["shapes"].split("/")),
        _sizes(row["sizes"]),
        (limits[0], limits[1]) if limits else None,
        tuple(row["faces"].split("/")) if row["faces"] else (),
        float(row["weight"]),
    )


with Path(__file__).with_suffix(".csv").open(encoding="utf-8", newline="") as _file:
    _ROWS = tuple(csv.DictReader(_file))

CATALOGUE = {
    system: tuple(_sign(row) for row in _ROWS if row["system"] == system) for system in SYSTEMS
}
UNIT_M = {US: INCH_M, VIENNA: MM_M}
"""Length of the unit that the sizes of each system are in, metres."""


@lru_cache(maxsize=1 << 12)
def stated(system: str, code: str, legend: str | None) -> tuple[str, ...]:
    """What a code or series with its legend says, from the widest: category, group, series, code, code with legend.

    A code that the catalogue does not have says itself alone.
    """
    series = next((one.series for one in CATALOGUE[system] if one.code == code), code)
    _, group, category = SERIES[system].get(series, ("", None, None))
    every = (category, group, series, code, f"{code} {legend}" if legend else None)
    return tuple(dict.fromkeys(one for one in every if one is not None))


CODES = tuple(
    dict.fromkeys(
        (system, stated(system, one.code, face.partition(" ")[2])[-1])
        for system in SYSTEMS
        for one in CATALOGUE[system]
        if one.code != one.series
        for face in one.faces or ("",)
    )
)
"""Every code of both systems, with each of its legends where it has some."""
