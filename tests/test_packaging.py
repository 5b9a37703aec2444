"""What is installed is what stands in the folders, with dependencies that are pinned and explained."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

import wayside

ROOT = Path(__file__).parents[1]
LAYERS = ("pipeline", "stages", "schemas")


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def requirement_name(text: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", text.strip(), maxsplit=1)[0]).lower()


LOCKS = ("requirements.lock", "requirements-learn.lock")


def pins() -> dict[str, str]:
    lines = [line for name in LOCKS for line in (ROOT / name).read_text().splitlines()]
    return dict(
        (requirement_name(name), number)
        for name, _, number in (line.partition("==") for line in lines if line and line[0] != "#")
    )


def test_every_folder_with_modules_is_a_listed_package(project: dict[str, Any]) -> None:
    folders = {
        ".".join(("wayside", *path.parent.relative_to(ROOT).parts))
        for layer in LAYERS
        for path in (ROOT / layer).rglob("*.py")
        if "__pycache__" not in path.parts
    }
    assert set(project["tool"]["setuptools"]["packages"]) == {"wayside", *folders}


def test_every_package_has_an_init_module(project: dict[str, Any]) -> None:
    for name in project["tool"]["setuptools"]["packages"]:
        folder = ROOT.joinpath(*name.split(".")[1:])
        assert (folder / "__init__.py").is_file(), name


def test_the_package_is_marked_as_typed() -> None:
    assert (ROOT / "py.typed").is_file()


def test_the_checkout_is_the_package(project: dict[str, Any]) -> None:
    assert project["tool"]["setuptools"]["package-dir"] == {"wayside": "."}
    assert Path(wayside.__file__) == ROOT / "__init__.py"
    assert wayside.__version__ == project["project"]["version"]


def test_the_repository_holds_no_symbolic_link() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "-s"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert not [line for line in listed.stdout.splitlines() if line.startswith("120000")]


def test_every_data_file_is_packed_with_the_package_it_lies_in(project: dict[str, Any]) -> None:
    setuptools = project["tool"]["setuptools"]
    folders = {name: ROOT.joinpath(*name.split(".")[1:]) for name in setuptools["packages"]}
    packed = {
        path
        for name, folder in folders.items()
        for pattern in setuptools["package-data"].get(name, ())
        for path in folder.glob(pattern)
    }
    for layer in LAYERS:
        for path in (ROOT / layer).rglob("*"):
            if path.is_file() and path.suffix != ".py" and "__pycache__" not in path.parts:
                assert path in packed, path


def test_every_dependency_is_pinned_and_explained(project: dict[str, Any]) -> None:
    extras = project["project"]["optional-dependencies"]
    wanted = [
        *project["project"]["dependencies"],
        *(name for extra in extras.values() for name in extra),
    ]
    words = (ROOT / "docs" / "dependencies.md").read_text()
    for text in wanted:
        name = requirement_name(text)
        # a peer to compare with is nobody's need, and the others few people's: they are installed by hand
        by_hand = [text for name in ("benchmark", "fleet", "query") for text in extras[name]]
        assert name in pins() or text in by_hand, f"{name} is not in requirements.lock"
        assert f"`{name}`" in words, f"{name} is not explained in docs/dependencies.md"


def test_nothing_is_explained_that_is_no_longer_used(project: dict[str, Any]) -> None:
    extras = project["project"]["optional-dependencies"].values()
    wanted = [*project["project"]["dependencies"], *(name for extra in extras for name in extra)]
    names = {requirement_name(text) for text in wanted}
    rows = re.findall(
        r"^\| `([\w-]+)` \|", (ROOT / "docs" / "dependencies.md").read_text(), re.MULTILINE
    )
    assert set(rows) == names
    assert len(rows) == len(set(rows))


def test_pins_hold_versions_and_no_places() -> None:
    for line in (line for name in LOCKS for line in (ROOT / name).read_text().splitlines()):
        assert line.startswith("#") or re.fullmatch(r"[\w.-]+==[\w.!+]+", line), line


def test_the_change_log_knows_the_version(project: dict[str, Any]) -> None:
    assert project["project"]["version"] == version("wayside")
    log = (ROOT / "CHANGELOG.md").read_text()
    assert re.search(
        r"^## \[?(Unreleased|" + re.escape(version("wayside")) + r")\b", log, re.MULTILINE
    )


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "wayside", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("wayside ")
