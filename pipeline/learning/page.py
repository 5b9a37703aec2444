"""Figures and the page that shows them: one HTML file without script, that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from jinja2 import Environment, PackageLoader


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as HTML, an `img` or an `svg`, and its words."""

    html: str
    words: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of the report, or without a number pictures and a table under a chapter.

    `number`, `title`. `report`: what the report shows and which number it gives. `ours`: the same of this drive.
    `needs`: why it is left out (empty: it is not). `table`: rows of cells, the first one the head.
    """

    number: str
    title: str
    report: str
    ours: str = ""
    pictures: Sequence[Picture] = ()
    needs: str = ""
    table: Sequence[Sequence[str]] = ()

    def shown(self, ours: str, *pictures: Picture, table: Sequence[Sequence[str]] = ()) -> Figure:
        """The same with what this drive gives."""
        return replace(self, ours=ours, pictures=pictures, table=table)

    def left_out(self, needs: str) -> Figure:
        """The same without, and what it needs."""
        return replace(self, needs=needs)


def format_page(
    title: str,
    intro: Iterable[str],
    chapters: Iterable[tuple[str, Iterable[Figure]]],
    head: str = "",
) -> str:
    """The whole page. `intro`: paragraphs. `head`: HTML for its head."""
    templates = Environment(loader=PackageLoader("wayside.pipeline.learning", ""), autoescape=True)
    page = templates.get_template("page.html")
    return page.render(title=title, intro=intro, chapters=chapters, head=head)
