"""The page of the checks of a drive: by rule, with an image of each sign that needs looking at."""

from collections.abc import Sequence
from pathlib import Path

from wayside.pipeline import pages
from wayside.pipeline.checking.rules import Rule
from wayside.pipeline.checking.verdicts import SHOWN, Check
from wayside.pipeline.evidence.crops import crop_addresses
from wayside.schemas.tables import CHECK_VERDICTS

PAGE_FILE = "checks.html"
_SIZE = 240, 180
_MARK = "wayside check"


def write_page(
    out: Path,
    rules: Sequence[Rule],
    checks: Sequence[Check],
    *,
    log: Path | None = None,
    overwrite: bool = False,
) -> str:
    """Write the checks of the result `out` as a page in it, with links to the evidence that lies there.

    `log`: where the log lies now. Returns why there are no images, or an empty text. Raises OutputError.
    """
    signs = {check.name: check.sign for check in checks if check.verdict in SHOWN}
    boxes = [(name, one["best_frame"], tuple(one["best_box"])) for name, one in signs.items()]
    images, fault = crop_addresses(out, log, boxes, _SIZE)
    sheets = {check.name: f"evidence/{check.name}.html" for check in checks}
    worst_first = sorted(
        checks, key=lambda check: -check.probability if check.probability >= 0 else 1.0
    )
    page = pages.render_page(
        "checks.html",
        _MARK,
        name=out.resolve().name,
        verdicts=CHECK_VERDICTS,
        shown=SHOWN,
        rules=[(rule, [check for check in worst_first if check.rule is rule]) for rule in rules],
        images=images,
        sheets={name: sheet for name, sheet in sheets.items() if (out / sheet).is_file()},
    )
    pages.write_page(out / PAGE_FILE, page, _MARK, overwrite=overwrite)
    return fault
