"""Text from logs, files and names as it can be shown: nothing in it acts on a terminal or forges a line."""

import shutil
import textwrap


def visible(text: str, keep: str = "") -> str:
    r"""The text with every invisible character as its escape, such as `\x1b`.

    These are control characters (ESC starts commands to a terminal), line ends, and invisible ones that turn the
    direction of writing. Surrogates stand for bytes of names that are not UTF-8. Characters of `keep` are kept.
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in keep else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


def counted(count: int, noun: str, several: str = "") -> str:
    """The count with its noun, or with the words for several, which else end in "s"."""
    return f"{count} {noun if count == 1 else several or noun + 's'}"


def visible_lines(text: str) -> str:
    """Text of several lines, made visible line by line."""
    return visible(text, keep="\n\t")


def fitted(text: str) -> str:
    """Lines broken at words for the width of the terminal; lines with a command stay whole, to be copied."""
    width = shutil.get_terminal_size().columns
    lines = []
    for line in text.splitlines():
        if len(line) > width and "wayside run" not in line:
            indent = " " * (len(line) - len(line.lstrip()) + 4)
            line = textwrap.fill(
                line,
                width,
                subsequent_indent=indent,
                break_long_words=False,
                break_on_hyphens=False,
            )
        lines.append(line)
    return "\n".join(lines)
