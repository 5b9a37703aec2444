"""How the command line explains itself: commands by what they are for, examples one a line."""

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.models import CommandFunctionType

from wayside.pipeline.files.visible_text import visible
from wayside.schemas.errors import UsageError

READ, DETECT, ROUTE, VIEW = "Input", "Settings and models", "Route", "Viewer"
"""Headings of options; what stands under none of them is said first."""


def examples(*lines: str) -> str:
    """The examples of a command for its help, one a line."""
    return "Examples:\n\n" + "\n".join(f"- `{line}`" for line in lines)


def remark(words: str) -> None:
    """Say on stderr what is not the result."""
    typer.echo(visible(words), err=True)


class _PlainFlags:
    """Flags show no type, as they take no value; types of `ctx` and parameters are private to typer."""

    def get_params(self, ctx: Any) -> Any:
        params: Any = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params


class _Command(_PlainFlags, TyperCommand):
    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        """As `TyperCommand.parse_args`, but UsageError names all that is missing, not the first only."""
        given: dict[str, Any] = self.make_parser(ctx).parse_args(args=list(args))[0]
        needed = [one for one in self.get_params(ctx) if one.required]
        missing = [
            one.metavar if one.param_type_name == "argument" else max(one.opts, key=len)
            for one in needed
            if given.get(one.name) in (None, ())
        ]
        if len(missing) > 1 and not given.get("help") and not ctx.resilient_parsing:
            raise UsageError(f"missing: {', '.join(missing)}. --help explains them.")
        return super().parse_args(ctx, args)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """As `TyperCommand.collect_usage_pieces`, the braces that typer sets around what must be given left out."""
        return [
            piece.replace("{", "").replace("}", "").replace("......", "...")
            for piece in super().collect_usage_pieces(ctx)
        ]


class CommandGroup(_PlainFlags, TyperGroup):
    """A group of commands."""


class Application(typer.Typer):
    """A typer application whose commands stand under one heading of the help."""

    def __init__(self, heading: str = "Commands", **rest: Any) -> None:
        super().__init__(rich_markup_mode="markdown", **({"cls": CommandGroup} | rest))
        self._heading = heading

    def command(
        self, name: str | None = None, **rest: Any
    ) -> Callable[[CommandFunctionType], CommandFunctionType]:
        """As `typer.Typer.command`."""
        return super().command(name, cls=_Command, rich_help_panel=self._heading, **rest)
