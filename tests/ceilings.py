"""Is the house within its ceilings? Run by `make check`.

`[tool.wayside.ceilings]` of pyproject.toml states the most lines of code of each folder (Python, HTML and JavaScript),
lines of Markdown, settings, and functions of more than `LONGEST` lines. A ceiling may fall from one commit to the next
and never rise. What is above a ceiling is listed, and the exit status is 1.
"""

import ast
import subprocess
import sys
import tomllib
from dataclasses import fields
from pathlib import Path

from wayside.schemas.settings import Settings

ROOT = Path(__file__).parents[1]
LONGEST = 60
CODE = (".py", ".html", ".js")


def git(*arguments: str) -> str:
    """What git prints; nothing where it fails, as on the first commit."""
    done = subprocess.run(
        ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False
    )
    return done.stdout


def ceilings_in(pyproject: str) -> dict[str, int]:
    """The ceilings that the text of a pyproject.toml states."""
    return dict(tomllib.loads(pyproject).get("tool", {}).get("wayside", {}).get("ceilings", {}))


def measured(names: list[str]) -> dict[str, int]:
    """What the files of the repository come to, by the name of each ceiling."""
    found = {"markdown": 0, "long_functions": 0, "settings": _settings()}
    for name in names:
        path = ROOT / name
        if not path.is_file():
            continue
        folder, _, rest = name.partition("/")
        text = path.read_text("utf-8") if path.suffix in (*CODE, ".md") else ""
        if path.suffix == ".md":
            found["markdown"] += text.count("\n")
        elif text and rest:
            found[folder] = found.get(folder, 0) + text.count("\n")
        if path.suffix == ".py":
            found["long_functions"] += _long_functions(text)
    return found


def _settings() -> int:
    settings = Settings()
    return sum(len(fields(getattr(settings, group.name))) for group in fields(Settings))


def _long_functions(text: str) -> int:
    functions = (
        one
        for one in ast.walk(ast.parse(text))
        if isinstance(one, (ast.FunctionDef, ast.AsyncFunctionDef))
    )
    return sum((one.end_lineno or 0) - one.lineno + 1 > LONGEST for one in functions)


def main() -> int:
    """Compare, and say what is too high."""
    ceilings = ceilings_in((ROOT / "pyproject.toml").read_text("utf-8"))
    before = ceilings_in(git("show", "HEAD^:pyproject.toml"))
    found = measured(git("ls-files").splitlines())
    faults = [
        f"{name}: {found.get(name, 0)}, and the ceiling is {most}; take out as much as you add"
        for name, most in ceilings.items()
        if found.get(name, 0) > most
    ]
    faults += [
        f"{name}: the ceiling was {before[name]} and is {most}; ceilings only fall"
        for name, most in ceilings.items()
        if most > before.get(name, most)
    ]
    faults += [f"{name}: has no ceiling any more" for name in before if name not in ceilings]
    for name, most in ceilings.items():
        print(f"{name:16} {found.get(name, 0):6} of {most:6}")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
