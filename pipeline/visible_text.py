"""Text from logs, files and names as it can be shown: nothing in it acts on a terminal or forges a line."""

from __future__ import annotations


def visible(text: str, keep: str = "") -> str:
    r"""The text with every character that has no form of its own as its escape, such as `\x1b`.

    These are control characters (ESC starts commands to a terminal), line ends, invisible ones that turn the direction
    of writing, and the surrogates that stand for bytes of names that are not UTF-8. Characters of `keep` are kept.
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in keep else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


def visible_lines(text: str) -> str:
    """Text of several lines, made visible line by line."""
    return visible(text, keep="\n\t")
