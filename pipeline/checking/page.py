"""The page of the checks of a drive: by rule, with an image of each sign that needs looking at."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wayside.pipeline.checking.rules import Rule
from wayside.pipeline.checking.verdicts import Check
from wayside.pipeline.code_words import code_of
from wayside.pipeline.evidence.crops import draw_crop, read_crops
from wayside.pipeline.evidence.marks import appearance_of
from wayside.pipeline.files.pictures import data_address, encode_webp, is_marked
from wayside.pipeline.files.writing import write_file
from wayside.pipeline.pages import render_page
from wayside.schemas.errors import InputError
from wayside.schemas.tables import CHECK_VERDICTS

PAGE_FILE = "checks.html"
SHOWN = ("fails", "unclear")
"""Verdicts whose signs have an image on the page."""
_SIZE = 240, 180
_MARK = "wayside check"


def write_page(
    out: Path,
    rules: Sequence[Rule],
    checks: Sequence[Check],
    file: Path,
    *,
    log: Path | None = None,
    overwrite: bool = False,
) -> str:
    """Write the checks of the result `out` as a page, with links to its evidence where that lies beside the page.

    log: where the log lies now. Returns why there are no images, or an empty text. Raises OutputError.
    """
    images, fault = _images(out, checks, log)
    counts = Counter((check.rule.id, check.verdict) for check in checks)
    by_rule: defaultdict[str, list[Check]] = defaultdict(list)
    for check in checks:
        by_rule[check.rule.id].append(check)
    held = [rule for rule in rules if by_rule[rule.id]]
    page = render_page(
        "checks.html",
        _MARK,
        name=out.resolve().name,
        verdicts=list(CHECK_VERDICTS),
        rules=[
            (rule, {one: counts[rule.id, one] for one in CHECK_VERDICTS}, _groups(by_rule[rule.id]))
            for rule in held
        ],
        images=images,
        others=[rule for rule in rules if not by_rule[rule.id]],
        linked={
            name: f"evidence/{name}.html"
            for name in {str(check.sign["sign_id"]) for check in checks}
            if (out / "evidence" / f"{name}.html").is_file()
        },
    )
    write_file(file, page.encode(), is_own=lambda path: is_marked(path, _MARK), overwrite=overwrite)
    return fault


def _groups(checks: Sequence[Check]) -> Mapping[str, list[dict[str, Any]]]:
    """What the page says of each check, by verdict; the likeliest to be broken first."""
    groups: dict[str, list[dict[str, Any]]] = {one: [] for one in CHECK_VERDICTS}
    for check in sorted(checks, key=lambda one: -one.probability):
        look = appearance_of(check.sign["color"], check.sign["shape"])
        said = {"id": check.sign["sign_id"], "face": code_of(check.sign) or look}
        groups[check.verdict].append(said | {"words": check.words})
    return groups


def _images(out: Path, checks: Sequence[Check], log: Path | None) -> tuple[dict[str, str], str]:
    """Addresses of images of the signs to look at, by id; and why there are none."""
    signs = {c.sign["sign_id"]: c.sign for c in checks if c.verdict in SHOWN}
    boxes = [(name, one["best_frame"], tuple(one["best_box"])) for name, one in signs.items()]
    images = {}
    try:
        for name, crop in read_crops(out, log, boxes, _SIZE[0] / _SIZE[1]):
            if crop is not None:
                images[name] = data_address(encode_webp(draw_crop(crop, _SIZE)))
    except InputError as error:
        return images, str(error)
    return images, ""
