"""How the command line explains itself: commands by what they are for, examples one a line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.models import CommandFunctionType

PANELS = {
    "A drive": ("info", "import", "join", "calibrate", "run", "replay"),
    "Its result": ("evidence", "view", "picture", "export", "evaluate"),
    "Many drives": ("fleet", "query", "changes"),
    "Your own roads": ("label", "fit", "roc"),
    "Settings and planning": ("settings", "simulate", "report-figures"),
}
"""The commands in the order in which they are used, under the headings of the help."""

READ, DETECT, ROUTE, VIEW = "What is read", "What decides", "Along the route", "Viewer"
"""Headings of options; what stands under none of them is said first."""


def examples(*lines: str) -> str:
    """The examples of a command for its help, one a line."""
    return "Examples:\n\n" + "\n".join(f"- `{line}`" for line in lines)


class _Command(TyperCommand):
    """A command whose flags show no type, as they take no value; types of `ctx` and parameters are private to typer."""

    def get_params(self, ctx: Any) -> Any:
        return _without_types_of_flags(super().get_params(ctx))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """As `TyperCommand.collect_usage_pieces`, the braces that typer sets around what must be given left out."""
        return [
            piece.replace("{", "").replace("}", "").replace("......", "...")
            for piece in super().collect_usage_pieces(ctx)
        ]


class CommandGroup(TyperGroup):
    """Commands whose common flags show no type."""

    def get_params(self, ctx: Any) -> Any:
        """As `TyperGroup.get_params`."""
        return _without_types_of_flags(super().get_params(ctx))


class Commands(CommandGroup):
    """Commands under headings."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names in the order of the help."""
        return [name for names in PANELS.values() for name in names]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name with its heading, or None."""
        command: Any = super().get_command(ctx, cmd_name)
        for heading, names in PANELS.items():
            if command is not None and cmd_name in names:
                command.rich_help_panel = heading
        return command


class Application(typer.Typer):
    """A typer application whose commands are of the classes above."""

    def command(
        self, name: str | None = None, *, cls: type[TyperCommand] | None = _Command, **rest: Any
    ) -> Callable[[CommandFunctionType], CommandFunctionType]:
        """As `typer.Typer.command`."""
        return super().command(name, cls=cls, **rest)


def _without_types_of_flags(params: Any) -> Any:
    for param in params:
        if getattr(param, "is_flag", False):
            param.metavar = ""
    return params
