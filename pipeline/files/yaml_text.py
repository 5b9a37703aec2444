"""YAML of files that others may have written."""

from __future__ import annotations

import re
from itertools import accumulate
from typing import Any

import yaml

from wayside.pipeline.files.json_text import CONTENT_FAULTS

_DEEPEST = 64
"""Brackets within each other; the parser takes time with the square of their number."""


class YamlLoader(yaml.SafeLoader):
    """The safe loader without aliases: with them a text stands for exponentially more than it is long."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """The next node; a fault where it is an alias."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("an alias (*name); write its value out")
        return super().compose_node(parent, index)


def parse_yaml(text: str, loader: type[YamlLoader] = YamlLoader) -> Any:
    """What a YAML text without aliases holds.

    Raises
    ------
    ValueError
        It is none, holds an alias, or is nested deeper than can be read.
    """
    steps = (1 if bracket in "[{" else -1 for bracket in re.findall(r"[\[\]{}]", text))
    if max(accumulate(steps), default=0) > _DEEPEST:
        raise ValueError("it is nested too deeply")
    try:
        return yaml.load(text, loader)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except (yaml.YAMLError, *CONTENT_FAULTS) as error:  # its own classes for dates and numbers
        raise ValueError(f"no YAML that is understood: {' '.join(str(error).split())}") from error
