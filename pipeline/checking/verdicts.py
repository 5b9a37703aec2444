"""Which rules each sign of a drive keeps: the probability that it does not, and what is missing to tell."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

from scipy.special import ndtr

from wayside.pipeline.checking.quantities import Measured, Row, measure
from wayside.pipeline.checking.rules import UNITS, Limits, Rule
from wayside.pipeline.code_words import code_of
from wayside.pipeline.evidence.marks import appearance_of
from wayside.pipeline.files.parquet import parquet_file, record_batch
from wayside.pipeline.files.writing import whole_file
from wayside.pipeline.results.result import holds_table, read_rows, read_run
from wayside.schemas.sign_catalogue import CATALOGUE, SERIES, UNIT_M, US, VIENNA, CatalogueSign
from wayside.schemas.tables import CHECK_VERDICTS, CHECKS, SECTIONS, SIGNS

SHOWN = ("fails", "unclear")
"""Verdicts whose signs have an image on the page."""
SURE = float(ndtr(2.0))
"""From this probability on a rule is broken, and up to one minus it met: two standard deviations from a limit."""
EXACT = 1e-9
"""Standard deviation of a value that is exact: keeps divisions finite."""
SECTION_M, EDGE_SIGMA = 8.0, 0.02
"""Distance of cross-sections, and scatter of the edge in them as part of its distance: that of the ground's height."""
SIZE_RANGE = 0.5, 1.3
"""A panel may be of a code if its sides are more than half of the shortest and not much more than the longest of it."""


@dataclass(frozen=True, slots=True)
class Check:
    """One rule and one sign that it holds for."""

    rule: Rule
    sign: Row
    verdict: str
    """One of `CHECK_VERDICTS`."""
    value: float = math.nan
    sigma: float = math.nan
    least: float = math.nan
    most: float = math.nan
    """Limits at the sign, with the tolerance; nan: none."""
    probability: float = math.nan
    """That the rule is broken."""
    missing: str = ""
    """What is not known. Empty: nothing."""

    @property
    def name(self) -> str:
        """Of the sign."""
        return str(self.sign["sign_id"])

    @property
    def face(self) -> str:
        """Its code, or how it looks."""
        return code_of(self.sign) or appearance_of(self.sign["color"], self.sign["shape"])

    @property
    def said(self) -> str:
        """The value and its limits in the unit of the rule, or what is missing."""
        if self.missing:
            return f"not known: {self.missing}"
        unit = UNITS[self.rule.unit]
        ends = (("at least", self.least), ("at most", self.most))
        limits = " and ".join(f"{w} {v / unit:.4g}" for w, v in ends if math.isfinite(v))
        spread = f" ± {self.sigma / unit:.2g}" if self.sigma else ""
        return f"{self.value / unit:z.1f}{spread} {self.rule.unit}, {limits}"


def check_drive(out: Path, rules: Sequence[Rule], road: str | None = None) -> list[Check]:
    """The checks of all rules on the faces that a drive reports; raises InputError where the folder is no result."""
    columns = [name for name in SIGNS.schema.names if name != "geometry"]
    run, read = read_run(out), read_rows(out, SIGNS, columns)
    edges: Sequence[Row] = ()
    if (out / SECTIONS.file).is_file():
        edges = read_rows(out, SECTIONS, ("station_m", "side", "edge_m"))
    rows = [row | from_edge(row, edges) for row in read if row["status"] == "sign"]
    us_probability = run.get("us_probability")
    system = US if us_probability is None or us_probability >= 0.5 else VIENNA
    return check_rows(rows, [rule for rule in rules if rule.system in ("", system)], road)


def from_edge(row: Row, edges: Sequence[Row]) -> dict[str, float]:
    """How far the panel is from the edge of the travelled way, metres, by the cross-section abreast of it."""
    if row["lateral_m"] is None:
        return {}
    side = "right" if row["lateral_m"] > 0 else "left"
    gaps = [
        (abs(one["station_m"] - row["station_m"]), one["edge_m"])
        for one in edges
        if one["side"] == side and one["edge_m"] is not None
    ]
    apart, edge = min(gaps, default=(math.inf, 0.0))
    if apart > SECTION_M:
        return {}
    sigmas = EDGE_SIGMA * edge, row["sigma_lateral_m"] or 0.0, (row["sigma_width_m"] or 0.0) / 2
    offset = abs(row["lateral_m"]) - (row["panel_width_m"] or 0.0) / 2 - edge
    return {"offset_edge_m": offset, "sigma_offset_edge_m": math.hypot(*sigmas)}


def check_rows(rows: Sequence[Row], rules: Sequence[Rule], road: str | None) -> list[Check]:
    """The same of rows of `signs.parquet`, in the order of rules, then rows; road: one of `ROADS`, None: not known."""
    supports = defaultdict(list)
    for row in rows:
        supports[row["assembly_id"]].append(row)
    return [
        check
        for rule in rules
        for row in rows
        if (check := _check(rule, row, rows, supports[row["assembly_id"]], road)) is not None
    ]


def _check(
    rule: Rule, row: Row, rows: Sequence[Row], support: Sequence[Row], road: str | None
) -> Check | None:
    """One check; None where the rule does not hold for the sign."""
    conditions = list(_conditions(rule, row, support, road))
    if any(holds is False for _, holds in conditions):
        return None
    found = measure(rule.quantity, row, rows)
    other = measure(rule.by, row, rows) if rule.by else Measured(0.0)
    unknown = next((name for name, holds in conditions if holds is None), "")
    if missing := unknown or found.missing or other.missing:
        return Check(rule, row, "not checkable", missing=missing)
    value, sigma = found.value, max(found.sigma, EXACT)
    low = [(p, limit - rule.tolerance) for p, limit in _at(rule.least, other)]
    high = [(p, limit + rule.tolerance) for p, limit in _at(rule.most, other)]
    under = sum(p * ndtr((limit - value) / sigma) for p, limit in low)
    over = sum(p * ndtr((value - limit) / sigma) for p, limit in high)
    broken = float(under + over * (1 - found.less))
    verdict = "fails" if broken >= SURE else "meets" if broken <= 1 - SURE else "unclear"
    least, most = (max(at, default=(0, math.nan))[1] for at in (low, high))
    return Check(rule, row, verdict, value, found.sigma, least, most, broken)


def _at(limits: Limits, by: Measured) -> list[tuple[float, float]]:
    """The probability of each limit, as far as the quantity is known that they depend on, with the limit."""
    at, before, sigma = [], 0.0, max(by.sigma, EXACT)
    for end, limit in limits:
        below = float(ndtr((end - by.value) / sigma))
        at.append((below - before, limit))
        before = below
    return at


def _conditions(
    rule: Rule, row: Row, support: Sequence[Row], road: str | None
) -> Iterator[tuple[str, bool | None]]:
    """Where the rule holds: each condition with whether it is met, None where that is not known."""
    if rule.codes:
        yield "its code", is_of(row, rule.codes)
    if rule.not_codes:
        excepted = is_of(row, rule.not_codes)
        yield "its code", None if excepted is None else not excepted
    if rule.system and (code := row["mutcd"] or row["vienna"]):
        yield "its system", (code == row["mutcd"]) == (rule.system == US)
    for name, one in (("colors", "color"), ("shapes", "shape")):
        if wanted := getattr(rule, name):
            yield f"its {one}", None if row[one] is None else row[one] in wanted
    if rule.sides:
        side = None if row["lateral_m"] is None else "right" if row["lateral_m"] > 0 else "left"
        yield "its side", None if side is None else side in rule.sides
    if rule.roads:
        yield "the kind of road", None if road is None else road in rule.roads
    if rule.below_another is not None and row["up_m"] is not None:
        above = any((other["up_m"] or -math.inf) > row["up_m"] for other in support)
        yield "its place on the support", above == rule.below_another
    if math.isfinite(rule.next_within):
        yield "the next of its type", (row["spacing_m"] or math.inf) <= rule.next_within


def is_of(row: Row, patterns: Sequence[str]) -> bool | None:
    """Whether a sign has one of these codes; None where its code is uncertain and its look and size allow one."""
    code = row["mutcd"] or row["vienna"]
    if code and any(fnmatchcase(code, pattern) for pattern in patterns):
        return True
    system = VIENNA if row["vienna"] else US
    if code and code not in SERIES[system]:
        return False
    possible = (
        sign
        for sign in CATALOGUE[system]
        if any(fnmatchcase(sign.code, pattern) for pattern in patterns)
        and code in (None, sign.series, SERIES[system][sign.series][1])
    )
    return None if any(_looks_like(row, sign, system) for sign in possible) else False


def _looks_like(row: Row, sign: CatalogueSign, system: str) -> bool:
    """Whether a sign can be one of the catalogue by what is known of its colour, shape and size."""
    if row["color"] not in (None, *sign.colors) or row["shape"] not in (None, *sign.shapes):
        return False
    if row["shape"] != "rectangle" or not sign.sizes:
        return True
    measured, (low, high) = (row["panel_width_m"], row["panel_height_m"]), SIZE_RANGE
    return all(
        value is None or low * min(sides) < value / UNIT_M[system] < high * max(sides)
        for value, sides in zip(measured, zip(*sign.sizes, strict=True), strict=True)
    )


def format_checks(rules: Sequence[Rule], checks: Sequence[Check]) -> str:
    """How many signs each rule has by verdict, and those that more likely break one than not, as lines of text."""
    lines = [f"{'rule':<28}{''.join(f'{verdict:>15}' for verdict in CHECK_VERDICTS)}"]
    for rule in rules:
        counts = Counter(check.verdict for check in checks if check.rule is rule)
        if counts:
            lines.append(f"{rule.id:<28}{''.join(f'{counts[v]:>15}' for v in CHECK_VERDICTS)}")
    for verdict in SHOWN:
        found = [c for c in checks if c.verdict == verdict and c.probability >= 0.5]
        if found:
            lines += ["", verdict if verdict == "fails" else f"{verdict}, probably broken"]
        lines += [f"  {c.rule.id:<28}{c.name}  {c.face:<26}{c.said}" for c in found]
    return "\n".join(lines)


def write_checks(checks: Sequence[Check], out: Path, *, overwrite: bool = False) -> None:
    """Write checks as a table into a result, also over an earlier one; raises OutputError."""
    columns: dict[str, list[Any]] = {name: [] for name in CHECKS.schema.names}
    for check in checks:
        for name, values in columns.items():
            rule_has = {"rule": check.rule.id, "sign_id": check.name, "code": code_of(check.sign)}
            value = rule_has.get(name, getattr(check, name, getattr(check.rule, name, None)))
            unknown = value == "" or (isinstance(value, float) and not math.isfinite(value))
            values.append(None if unknown else value)
    is_own = partial(holds_table, table=CHECKS)
    with (
        whole_file(out / CHECKS.file, is_own=is_own, overwrite=overwrite) as stream,
        parquet_file(stream, CHECKS.schema) as sink,
    ):
        sink.write_batch(record_batch(CHECKS, columns))
