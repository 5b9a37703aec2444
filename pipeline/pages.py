"""Pages made from the templates beside this module; Jinja escapes all text that is put into them."""

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from wayside.pipeline.evidence.marks import class_words, css, outline_of
from wayside.pipeline.files.pictures import is_marked, marked_head
from wayside.pipeline.files.writing import not_written, write_file


def render(template: str, **values: Any) -> str:
    """The text of a template with these values."""
    return _environment().get_template(template).render(values)


def render_page(template: str, mark: str, **values: Any) -> str:
    """An HTML page that needs no other file, and by which `is_marked` knows it again."""
    return render(template, marked_head=marked_head(mark), **values)


def write_page(file: Path, page: str, mark: str, *, overwrite: bool) -> None:
    """Write a page into a folder, which is made where it is missing; raises OutputError.

    overwrite: replace any file; else only a page of the same mark.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(file.parent, error, "the page") from error
    write_file(file, page.encode(), is_own=lambda path: is_marked(path, mark), overwrite=overwrite)


def shortened(words: str, most: int) -> str:
    """The words, cut in the middle where they have more than `most` characters, so that a number at the end stays."""
    kept = (most - 3) // 2
    return words if len(words) <= most else f"{words[:kept]}...{words[-kept:]}"


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    filters = {"class_words": class_words, "css": css, "outline": outline_of}
    environment.filters |= {**filters, "shortened": shortened}
    return environment
