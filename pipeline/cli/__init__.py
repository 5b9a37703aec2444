"""The command line: `main` is the program `wayside`, `app` its commands."""

from wayside.pipeline.cli.application import app, main

__all__ = ["app", "main"]
