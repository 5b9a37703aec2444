"""Class maps: a TOML file that says which classes of another detector are signs, and what these look like."""

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from wayside.pipeline.files.parsing import read_toml
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.detectors import SignClass
from wayside.schemas.errors import InputError

EXAMPLE = '[classes]\n"stop sign" = { color = "red", shape = "octagon" }'


def read_class_map(path: Path) -> dict[str, SignClass]:
    """The classes of signs in a class map, by name or number as it is written there.

    Raises InputError where the file cannot be read, has another structure, or names an unknown colour or shape.
    """
    what, advice = "models.classes: the class map at", f"Write it as in\n{EXAMPLE}"
    content = read_toml(path, what, advice, InputError)
    classes = content.pop("classes", None)
    if not isinstance(classes, dict) or not classes or content:
        found = ", ".join(content) or ("no class" if classes == {} else "no such table")
        raise InputError(
            f"models.classes: {path} must hold one table [classes], but it holds {found}. Write it as in\n{EXAMPLE}"
        )
    return {name: _sign_class(path, name, values) for name, values in classes.items()}


def _sign_class(path: Path, name: str, values: Any) -> SignClass:
    if not isinstance(values, dict) or set(values) - {"color", "shape"}:
        raise InputError(
            f"models.classes: class {name!r} in {path} must have a color and a shape, or be {{}} where wayside names "
            f"them, but is {values!r}. Write it as in\n{EXAMPLE}"
        )
    for what, known in (("color", COLORS), ("shape", SHAPES)):
        if what in values and values[what] not in known:
            raise InputError(
                f"models.classes: the {what} of class {name!r} in {path} is {values[what]!r}, which is unknown. "
                f"Choose one of {', '.join(known)}."
            )
    return SignClass(values.get("color"), values.get("shape"))


def numbered(
    classes: Mapping[str, SignClass], names: Mapping[int, str], path: str, *, complete: bool
) -> dict[int, SignClass]:
    """The classes of a class map by their numbers; raises InputError for a class that the detector does not have.

    `classes`: as `read_class_map` gives them. `names`: of the detector's classes by number; empty if it names none.
    `path`: the detector, for the error. `complete`: whether it has no other classes; else unknown ones are passed over.
    """
    by_name = {name: number for number, name in names.items()}
    found: dict[int, SignClass] = {}
    for name, sign in classes.items():
        if name in by_name:
            found[by_name[name]] = sign
        elif name.isdecimal() and (int(name) in names or not names):
            found[int(name)] = sign
        elif not names:
            raise InputError(
                f"models.classes: {path} does not name its classes, which makes {name!r} unknown. Write their numbers "
                'as keys in [classes], such as "0".'
            )
        elif complete:
            near = difflib.get_close_matches(name, by_name, n=1)
            known = ", ".join(list(by_name)[:20]) + (" ..." if len(by_name) > 20 else "")
            meant = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"models.classes: {path} has no class {name!r}; it has {known}{meant}")
    return found
