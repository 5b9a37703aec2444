"""The catalogue of sign codes: what colour, shape and size a sign of each code has.

Sources: Manual on Uniform Traffic Control Devices, 11th edition (FHWA, 2023), tables of sizes 2B-1, 2C-1, 2D-1, 2I-1,
6H-1, 7B-1 and 8B-1, with sizes of the 2009 edition and of Standard Highway Signs, which still stand on roads;
docs/sign_codes.md says what was compared with which text. Convention on Road Signs and Signals (Vienna 1968), annex 1,
which states least sizes only: those here are the common ones of its countries.

Sizes of a diamond are the side of its square, of a triangle its side twice, of a pennant its long side and its base, of
a crossbuck length and width of a blade.
"""

from __future__ import annotations

from dataclasses import dataclass

US, VIENNA = "us", "vienna"
SYSTEMS = (US, VIENNA)

INCH_M, MM_M = 0.0254, 0.001

SERIES: dict[str, dict[str, tuple[str, str | None]]] = {
    US: {
        "R": ("regulatory", None),
        "W": ("warning", None),
        "S": ("school", None),
        "TTC": ("temporary traffic control", None),
        "OM": ("object marker", None),
        "M": ("route marker", None),
        "D/E/I": ("guide", None),
        "D": ("guide of conventional roads", "D/E/I"),
        "E": ("guide of freeways and expressways", "D/E/I"),
    },
    VIENNA: {
        "A": ("danger warning", None),
        "B": ("priority", None),
        "C": ("prohibitory or restrictive", None),
        "D": ("mandatory", None),
        "E": ("special regulation", None),
        "G": ("direction, position or indication", None),
        "H": ("additional panel", None),
    },
}
"""Series of each system: what it means, and the group that it is stated as where it is not settled itself."""

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


def _squares(*sides: float) -> tuple[Size, ...]:
    return tuple((side, side) for side in sides)


def _sign(
    code: str,
    series: str,
    look: str,
    sizes: tuple[Size, ...] = (),
    faces: str = "",
    weight: float = 1.0,
    limits: tuple[Size, Size] | None = None,
) -> CatalogueSign:
    """look: colours and shapes, `red/white octagon`; faces: legends after `code`, `=` the code alone, or `:name`."""
    colors, shapes = (tuple(part.split("/")) for part in look.split())
    named = tuple(
        code if face == "=" else face[1:] if face.startswith(":") else f"{code} {face}"
        for face in faces.split(",")
        if face
    )
    return CatalogueSign(code, series, colors, shapes, sizes, limits, named, weight)


_PLATE = ((18.0, 24.0), (24.0, 30.0), (30.0, 36.0), (36.0, 48.0), (48.0, 60.0))
_PLATE_SKIPPING = ((18.0, 24.0), (24.0, 30.0), (36.0, 48.0), (48.0, 60.0))
_ARROW_PLAQUES = ((21.0, 15.0), (30.0, 21.0))
_PLAQUES = ((24.0, 12.0), (30.0, 18.0), (24.0, 18.0), *_ARROW_PLAQUES)
_SIDES = "left,right"
_DIAMONDS = _squares(24, 30, 36, 48)
_ROUTES = ((24.0, 24.0), (30.0, 24.0), (36.0, 36.0), (45.0, 36.0))

_US_SIGNS = (
    _sign("R1-1", "R", "red octagon", _squares(24, 30, 36, 48), ":stop", 6),
    _sign("R1-2", "R", "red/white triangle", _squares(30, 36, 48, 60), "=", 3),
    _sign("R2-1", "R", "white rectangle", _PLATE, ",".join(map(str, range(15, 80, 5))), 6),
    *(_sign(f"R3-{k}", "R", "white rectangle", _squares(24, 36, 48), "=") for k in (1, 2, 3, 4)),
    _sign("R3-5", "R", "white rectangle", ((30.0, 36.0),), "left,right,straight"),
    _sign("R4-1", "R", "white rectangle", _PLATE_SKIPPING, "="),
    _sign("R4-7", "R", "white rectangle", _PLATE_SKIPPING, "=", 2),
    _sign("R5-1", "R", "red/white rectangle/circle", _squares(30, 36, 48), "=", 2),
    _sign("R5-1a", "R", "red rectangle", ((30.0, 18.0), (36.0, 24.0), (42.0, 30.0))),
    _sign("R5-2", "R", "white rectangle", _squares(24, 30, 36), "="),
    _sign("R6-1", "R", "white rectangle", ((36.0, 12.0), (48.0, 18.0), (54.0, 18.0), (72.0, 24.0)), _SIDES),
    _sign("R6-2", "R", "white rectangle", _PLATE, _SIDES),
    _sign("R7-1", "R", "white rectangle", ((12.0, 18.0),), "=", 2),
    _sign("R8-3", "R", "white rectangle", _squares(12, 24, 30, 36, 48), "=", 2),
    _sign("R10-11", "R", "white rectangle", ((24.0, 30.0), (36.0, 48.0)), "="),
    _sign("R11-2", "R", "white rectangle", ((48.0, 30.0),), "="),
    _sign("R15-1", "R", "white crossbuck", ((48.0, 9.0),)),
    _sign("R15-2P", "R", "white rectangle", ((27.0, 18.0),)),
    _sign(
        "R",
        "R",
        "white rectangle",
        (*_PLATE, *_squares(24, 30, 36), (12.0, 18.0), (24.0, 18.0), (24.0, 36.0), (36.0, 24.0)),
        weight=10,
    ),
    *(_sign(f"W1-{k}", "W", "yellow diamond", _DIAMONDS, _SIDES, 1.5) for k in (1, 2, 3, 4, 5)),
    _sign("W1-6", "W", "yellow rectangle", ((36.0, 18.0), (48.0, 24.0), (60.0, 30.0)), _SIDES, 2),
    _sign("W1-8", "W", "yellow rectangle", _PLATE[:4], _SIDES, 3),
    _sign("W2-2", "W", "yellow diamond", _DIAMONDS, _SIDES),
    *(
        _sign(code, "W", "yellow diamond", _DIAMONDS, "=")
        for code in ("W2-1", "W2-4", "W2-5", "W3-1", "W3-2", "W3-3", "W14-1", "W14-2")
    ),
    *(
        _sign(code, "W", "yellow/fluorescent_yellow_green diamond", _DIAMONDS, "=")
        for code in ("W11-1", "W11-2")
    ),
    _sign("W10-1", "W", "yellow circle", _squares(36, 48), weight=2),
    _sign("W13-1P", "W", "yellow rectangle", _squares(18, 24, 30), ",".join(map(str, range(10, 55, 5))), 3),
    _sign("W14-3", "W", "yellow pennant", ((40.0, 30.0), (48.0, 36.0), (64.0, 48.0))),
    _sign("W", "W", "yellow diamond", _DIAMONDS, weight=15),
    _sign("W", "W", "fluorescent_yellow_green diamond", _DIAMONDS, weight=2),
    _sign("W", "W", "yellow rectangle", (*_PLAQUES, (30.0, 24.0)), weight=2),
    _sign("W", "W", "fluorescent_yellow_green rectangle", _PLAQUES),
    _sign("S1-1", "S", "fluorescent_yellow_green/yellow pentagon", _squares(30, 36, 48), "=", 2),
    _sign(
        "S",
        "S",
        "fluorescent_yellow_green rectangle",
        ((24.0, 8.0), (24.0, 9.0), (24.0, 10.0), (36.0, 12.0)),
        weight=2,
    ),
    _sign("W20-1", "TTC", "orange diamond", _squares(30, 36, 48), "=", 2),
    _sign("TTC", "TTC", "orange diamond", _squares(30, 36, 48), weight=6),
    _sign(
        "TTC",
        "TTC",
        "orange rectangle",
        ((48.0, 24.0), (36.0, 18.0), (60.0, 24.0), (30.0, 24.0), (24.0, 18.0), (48.0, 36.0)),
        weight=3,
    ),
    _sign("OM3", "OM", "yellow rectangle", ((12.0, 36.0),), weight=2),
    _sign("OM1", "OM", "yellow diamond", _squares(18)),
    _sign("M1-1", "M", "blue shield", _ROUTES, "=", 2),
    _sign("M1-4", "M", "white shield/rectangle", _ROUTES, "=", 2),
    _sign("M1-5", "M", "white rectangle", _ROUTES, "=", 2),
    _sign("M1-5", "M", "yellow rectangle", _ROUTES, weight=0.5),
    _sign("M1-6", "M", "blue pentagon", _squares(18, 24, 30, 36)),
    _sign("M3", "M", "white rectangle", ((24.0, 12.0), (30.0, 15.0), (36.0, 18.0)), weight=3),
    _sign("M6", "M", "white rectangle", _ARROW_PLAQUES, weight=2),
    _sign("D1", "D", "green rectangle", faces=":D1-1,:D1-2,:D1-3", weight=3, limits=((40, 15), (140, 60))),
    _sign("D3-1", "D", "green rectangle", faces="=", weight=4, limits=((18, 5.5), (110, 19))),
    _sign(
        "D10",
        "D",
        "green rectangle",
        ((10.0, 18.0), (10.0, 27.0), (10.0, 36.0), (12.0, 24.0), (12.0, 36.0)),
        weight=3,
    ),
    _sign("D", "D", "green rectangle", weight=3, limits=((18, 12), (140, 80))),
    _sign("D9", "D", "blue rectangle", _squares(18, 24, 30, 36), weight=3),
    _sign("D", "D", "blue rectangle", weight=3, limits=((18, 12), (180, 120))),
    _sign("D", "D", "brown rectangle", weight=4, limits=((12, 12), (180, 120))),
    _sign("E5-1", "E", "green rectangle", faces="=", limits=((48, 40), (130, 96))),
    _sign("E", "E", "green rectangle", weight=4, limits=((90, 48), (360, 200))),
)  # fmt: skip

_DISCS, _TRIANGLES = _squares(400, 600, 750, 900), _squares(600, 700, 900, 1200)
_LIMITS = "5,10,15,20,25,30,35,40,45,50,60,65,70,80,90,100,110,120,130"

_VIENNA_SIGNS = (
    *(
        _sign(code, "A", "white triangle", _TRIANGLES, "=")
        for code in (
            *("A1a", "A1b", "A1c", "A7", "A9", "A12", "A13", "A14", "A15b", "A16", "A17", "A19"),
            "A32",
        )
    ),
    _sign("A4", "A", "white triangle", _TRIANGLES, "right"),
    _sign("A", "A", "white triangle", _TRIANGLES, ":A ice,:other", 6),
    _sign("A28", "A", "white crossbuck", weight=2, limits=((600, 300), (1600, 1600))),
    _sign("A29", "A", "white/blue rectangle", ((300.0, 1000.0),), weight=2),
    _sign("B1", "B", "white triangle", _TRIANGLES, "=", 4),
    _sign("B2a", "B", "red octagon", _squares(600, 750, 900), ":stop", 6),
    _sign("B3", "B", "yellow diamond", _squares(400, 500, 600), "=", 3),
    _sign("C1a", "C", "red circle", _DISCS, ":C1", 3),
    _sign("C2", "C", "white circle", _DISCS, "="),
    _sign("C3e", "C", "white circle", _DISCS, "="),
    _sign("C13a", "C", "white circle", _DISCS, "=", 2),
    _sign("C13b", "C", "white circle", _DISCS, "="),
    _sign("C14", "C", "white circle", _DISCS, _LIMITS, 8),
    _sign("C17a", "C", "white circle", _DISCS, "="),
    _sign("C17b", "C", "white circle", _DISCS, "80"),
    _sign("C17c", "C", "white circle", _DISCS, "="),
    _sign("C17d", "C", "white circle", _DISCS, "="),
    _sign("C", "C", "white circle", _DISCS, weight=6),
    _sign("C", "C", "blue circle", _DISCS, weight=2),
    _sign(
        "D1", "D", "blue circle", _DISCS, "right,left,straight,straight or right,straight or left", 3
    ),
    _sign("D2", "D", "blue circle", _DISCS, "right,left", 2),
    _sign("D3", "D", "blue circle", _DISCS, "=", 2),
    _sign("D", "D", "blue circle", _DISCS, weight=3),
    _sign("E12", "E", "blue rectangle", _squares(500, 600, 750, 900), "=", 3),
    _sign("E14", "E", "blue rectangle", _squares(400, 500, 600, 750), "=", 3),
    _sign("E", "E", "blue rectangle", weight=3, limits=((300, 300), (1200, 1200))),
    _sign("E", "E", "yellow/white rectangle", weight=3, limits=((700, 400), (1800, 1000))),
    _sign("G", "G", "white/yellow/blue/green rectangle", weight=6, limits=((700, 200), (5000, 3500))),
    _sign("H", "H", "white rectangle", weight=3, limits=((250, 120), (900, 700))),
)  # fmt: skip

CATALOGUE = {US: _US_SIGNS, VIENNA: _VIENNA_SIGNS}
UNIT_M = {US: INCH_M, VIENNA: MM_M}
"""Length of the unit that the sizes of each system are in, metres."""
