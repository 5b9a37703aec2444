"""Settings of what sign it is."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class CodeSettings:
    """The code of a sign by all that was measured of it."""

    system: str = setting(
        "auto",
        "",
        "system that the signs are of: `us` (MUTCD), `vienna` (Vienna Convention), or `auto`: by the signs themselves",
        origin="a drive crosses no ocean",
        choices=("auto", "us", "vienna"),
    )
    foreign: float = setting(
        0.01,
        "",
        "share of signs of the other system on a drive, where the system is `auto`",
        origin="estimate: signs at borders, on private ground, copied ones",
        expert=True,
        low=0,
        high=0.5,
    )
    settled: float = setting(
        0.9,
        "",
        "probability from which a code is stated, else the series it belongs to, else nothing",
        origin="one stated code in ten may be wrong at the least sure",
        low=0.5,
        high=1,
    )
    size_sigmas: float = setting(
        2.0,
        "sigma",
        "a standard size is stated where width and height are this near",
        origin="95 % of normal errors",
        low=0,
    )
    size_tolerance: float = setting(
        0.03,
        "",
        "relative scatter of the extent of a face about its nominal size, rounded corners included",
        origin="a diamond of 30 in is 40.9 in wide, not 42.4 (Standard Highway Signs)",
        expert=True,
        low=1e-3,
    )
    named_right: float = setting(
        0.9,
        "",
        "probability that a colour or shape is right where no network states it",
        origin="estimate",
        expert=True,
        low=0.5,
        high=1,
    )
    unlike: float = setting(
        0.01,
        "",
        "probability that a sign is like nothing in the catalogue, or measured wrong; bounds what one sign says of "
        "the system of the drive",
        origin="estimate",
        expert=True,
        low=1e-6,
        high=0.5,
    )
    odd_size: float = setting(
        0.1,
        "",
        "probability that a sign has none of the sizes of its code, or was measured wrong",
        origin="estimate",
        expert=True,
        low=1e-4,
        high=0.5,
    )
    misread: float = setting(
        0.11,
        "",
        "probability that the classifier of faces is wrong whatever it says: it bounds what the pixels say",
        origin="share of crops of tracks held out that it names wrong: 0.08 in colour, 0.10 in grey",
        expert=True,
        low=1e-4,
        high=0.5,
    )
    other_share: float = setting(
        0.1,
        "",
        "share of faces that are none of its codes among those that the classifier of faces was taught",
        origin="`make learn-faces` teaches this default; the codes share the rest alike",
        expert=True,
        low=1e-3,
        high=0.99,
    )
    smallest_side_m: float = setting(
        0.1, "m", "smallest side that a panel of no standard size may have", expert=True, low=0.01,
        origin="between both, sides are log-uniform",
    )  # fmt: skip
    largest_side_m: float = setting(
        8.0, "m", "and largest", expert=True, low=1, origin="set by hand",
    )  # fmt: skip
    face_views: int = setting(
        5,
        "views",
        "nearest registered views whose face is classified",
        origin="farther ones are coarser",
        expert=True,
        low=1,
    )
    least_log_probability: float = setting(
        -7.0,
        "",
        "least log probability of a class of face in one view",
        origin="one bad view must not rule a class out",
        expert=True,
        high=0,
    )
