"""The figures of a sign in words, in groups, as they stand on a sheet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from wayside.pipeline.code_words import code_of, nominal_words, series_words, system_words
from wayside.pipeline.evidence.marks import class_words
from wayside.schemas.landmarks import EVIDENCE_TERMS

UNKNOWN = "unknown"
MEASUREMENT = "Measurement"
"""Heading of what says how well the sign was measured."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One line: what, its value with unit, and its standard deviation or a remark."""

    label: str
    value: str
    remark: str = ""


def figures_of(sign: dict[str, Any], world: str) -> dict[str, list[Figure]]:
    """All figures of a row of `signs.parquet` by heading.

    Parameters
    ----------
    sign
        Values by column name, None where not known.
    world
        Name of the world frame, from `run.json`.
    """
    return {
        "Position": [*_beside_the_road(sign), *_in_the_world(sign, world)],
        "Panel": _panel(sign),
        MEASUREMENT: _measurement(sign),
    }


def evidence_terms(sign: dict[str, Any]) -> list[tuple[str, float]]:
    """Terms of the evidence for a sign with their log-likelihood ratios; none where it was not weighed."""
    ratios = [(term, sign.get(f"evidence_{term}")) for term in EVIDENCE_TERMS]
    return [(term, ratio) for term, ratio in ratios if ratio is not None]


def _beside_the_road(sign: dict[str, Any]) -> list[Figure]:
    side = "" if sign["lateral_m"] is None else "right" if sign["lateral_m"] >= 0 else "left"
    lateral = None if sign["lateral_m"] is None else abs(sign["lateral_m"])
    route = [] if sign.get("measure") is None else [_on_route(sign)]
    return [
        *route,
        Figure("Along the road", _metres(sign["station_m"]), _sigma(sign["sigma_along_m"], "m")),
        Figure(
            f"Beside the path, {side}" if side else "Beside the path",
            _metres(lateral),
            _sigma(sign["sigma_lateral_m"], "m"),
        ),
        Figure("Centre above the road", _metres(sign["up_m"]), _sigma(sign["sigma_up_m"], "m")),
        Figure("Lower edge above it", _metres(sign["bottom_m"])),
    ]


def _on_route(sign: dict[str, Any]) -> Figure:
    at = f"{sign['measure']:.3f} {sign['measure_unit']}"
    return Figure("Route", f"{sign['route']}, {at}" if sign["route"] else at)


def _in_the_world(sign: dict[str, Any], world: str) -> list[Figure]:
    variances = sign["covariance"]
    sigmas = [None] * 3 if variances is None else [variances[i] ** 0.5 for i in (0, 3, 5)]
    axes = ("East", "North", "Up") if world == "enu" else ("World x", "World y", "World z")
    rows = [
        Figure(label, _metres(sign[axis]), _sigma(sigma, "m"))
        for label, axis, sigma in zip(axes, "xyz", sigmas, strict=True)
    ]
    if sign["lon_deg"] is not None and sign["lat_deg"] is not None:
        north, east = (_sigma(sign[f"sigma_{side}_m"], "m") for side in ("north", "east"))
        rows.append(Figure("Latitude", f"{sign['lat_deg']:.7f}°", north))
        rows.append(Figure("Longitude", f"{sign['lon_deg']:.7f}°", east))
    return rows


def _panel(sign: dict[str, Any]) -> list[Figure]:
    facing = UNKNOWN if sign["facing_deg"] is None else f"{sign['facing_deg']:z.0f}°"
    nominal = nominal_words(sign)
    return [
        *_code(sign),
        Figure("Colour", class_words(sign["color"])),
        Figure("Shape", class_words(sign["shape"])),
        Figure("Width", _metres(sign["panel_width_m"]), _sigma(sign["sigma_width_m"], "m")),
        Figure("Height", _metres(sign["panel_height_m"]), _sigma(sign["sigma_height_m"], "m")),
        *([] if nominal is None else [Figure("Standard size", nominal)]),
        Figure("Facing", facing, _sigma(sign["sigma_facing_deg"], "°")),
    ]


def _code(sign: dict[str, Any]) -> list[Figure]:
    code, series = code_of(sign), series_words(sign)
    if code is None:
        return [Figure("Code", UNKNOWN)]
    probability = f"probability {sign['code_probability']:.2f}"
    return [
        Figure("Code", f"{code} ({system_words(sign)})", probability),
        *([] if series is None else [Figure("Series", series)]),
    ]


def _measurement(sign: dict[str, Any]) -> list[Figure]:
    frames = f"frames {sign['first_frame']} to {sign['last_frame']}"
    residual = sign["residual_px"]
    distances = [
        Figure(f"Mahalanobis distance, {name}", f"{sign[f'{name}_distance']:.1f}")
        for name in ("color", "shape")
        if sign[f"{name}_distance"] is not None
    ]
    return [
        Figure("Views", str(sign["views"]), frames),
        Figure("Residual, RMS", UNKNOWN if residual is None else f"{residual:.2f} px"),
        *(
            [Figure("Best image", name, sign["image_date"])]
            if (name := sign.get("image_name"))
            else []
        ),
        *distances,
    ]


def _metres(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:z.2f} m"


def _sigma(value: float | None, unit: str) -> str:
    if value is None:
        return ""
    return f"± {value:.0f}{unit}" if unit == "°" else f"± {value:.2f} {unit}"
