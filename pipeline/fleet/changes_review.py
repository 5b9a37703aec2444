"""What people say of changes on their page, and the columns of the table of changes that it fills."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.fleet.absence import Row
from wayside.schemas.errors import InputError
from wayside.schemas.inventory_tables import CHANGE_REVIEWS, CONFIRMED


def _key(row: Row) -> tuple[Any, ...]:
    """By what a change is known again in another comparison."""
    return tuple(row.get(name) or None for name in ("change", "panel_before", "panel_after"))


@dataclass(frozen=True, slots=True)
class ChangeReview:
    """What several people say of the changes between two surveys."""

    said: defaultdict[tuple[Any, ...], list[Row]] = field(default_factory=lambda: defaultdict(list))
    """By change; `columns` takes it out, so that what is left is of no change that was found."""
    counts: Counter[str] = field(default_factory=Counter)
    """What `columns` made of it."""

    def read(self, inventory: Path, given: Sequence[Path]) -> None:
        """Add the files given, else those in the folder of the inventory; raises InputError where one is no review."""
        for file in given or sorted(inventory.glob("changes.review*.json")):
            try:
                for row in parse_json(read_input_text(file))["reviews"]:
                    if row["review"] in CHANGE_REVIEWS:
                        self.said[_key(row)].append(row)
            except (OSError, *CONTENT_FAULTS) as error:
                raise InputError(
                    f"{file}: this is not a review as the page of changes saves it: {error}"
                ) from error

    def columns(self, row: Row) -> Row:
        """The columns of a change that its review fills; where reviewers disagree, it counts as not reviewed."""
        said = self.said.pop(_key(row), [])
        verdicts = {one["review"] for one in said}
        if len(verdicts) != 1:
            self.counts["on which reviewers disagree"] += len(verdicts) > 1
            return {"final_change": row["change"]}
        (verdict,) = verdicts
        self.counts[verdict] += 1
        people, notes = (
            "; ".join(dict.fromkeys(str(one[name]) for one in said if one.get(name))) or None
            for name in ("reviewer", "note")
        )
        final = row["change"] if verdict == CONFIRMED else None
        return {"review": verdict, "final_change": final, "reviewer": people, "review_note": notes}

    def __str__(self) -> str:
        """A line for a person; empty without a review."""
        counts = self.counts + Counter({"of changes that are not found": len(self.said)})
        words = ", ".join(f"{number} {name}" for name, number in sorted(counts.items()))
        return f"reviews: {words}" if words else ""
