"""The installed package holds the files of the folders; its dependencies are pinned and explained."""

import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

import wayside.pipeline

ROOT = Path(__file__).parents[1]
LAYERS = ("pipeline", "stages", "schemas")
OUTSIDE = ("training", "recordings", "tests")


@pytest.fixture(scope="module")
def project():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def requirement_name(text):
    return re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", text.strip(), maxsplit=1)[0]).lower()


LOCKS = ("requirements.lock", "requirements-learn.lock")


def pins():
    lines = [line for name in LOCKS for line in (ROOT / name).read_text().splitlines()]
    return dict(
        (requirement_name(name), number)
        for name, _, number in (line.partition("==") for line in lines if line and line[0] != "#")
    )


def test_a_wheel_holds_every_file_of_the_package_and_no_other(tmp_path):
    source = tmp_path / "source"
    left_out = shutil.ignore_patterns(".*", "__pycache__", "build", "*.egg-info", *LAYERS)
    shutil.copytree(ROOT / "wayside", source / "wayside", ignore=left_out)
    for name in LAYERS + OUTSIDE:
        shutil.copytree(
            ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", "*.mcap")
        )
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    build = f"from setuptools.build_meta import build_wheel; build_wheel({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    with zipfile.ZipFile(next(tmp_path.glob("*.whl"))) as archive:
        packed = archive.namelist()
    wanted = {
        f"{prefix}{path.relative_to(ROOT)}"
        for layer, prefix in (("wayside", ""), *((layer, "wayside/") for layer in LAYERS))
        for path in (ROOT / layer).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in packed if ".dist-info/" not in name} == wanted


def test_every_folder_with_modules_has_an_init_module():
    for layer in LAYERS:
        for path in (ROOT / layer).rglob("*.py"):
            assert (path.parent / "__init__.py").is_file(), path


def test_the_package_is_that_of_the_checkout(project):
    assert Path(wayside.__file__) == ROOT / "wayside" / "__init__.py"
    assert Path(wayside.pipeline.__file__).resolve() == ROOT / "pipeline" / "__init__.py"
    assert wayside.__version__ == project["project"]["version"]


def test_the_repository_holds_no_symbolic_link():
    listed = subprocess.run(
        ["git", "ls-files", "-s"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert not [line for line in listed.stdout.splitlines() if line.startswith("120000")]


def test_every_dependency_is_pinned_and_explained(project):
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


def test_nothing_is_explained_that_is_no_longer_used(project):
    extras = project["project"]["optional-dependencies"].values()
    wanted = [*project["project"]["dependencies"], *(name for extra in extras for name in extra)]
    names = {requirement_name(text) for text in wanted}
    rows = re.findall(
        r"^\| `([\w-]+)` \|", (ROOT / "docs" / "dependencies.md").read_text(), re.MULTILINE
    )
    assert set(rows) == names
    assert len(rows) == len(set(rows))


def test_pins_hold_versions_and_no_places():
    for line in (line for name in LOCKS for line in (ROOT / name).read_text().splitlines()):
        assert line.startswith("#") or re.fullmatch(r"[\w.-]+==[\w.!+]+", line), line


def test_the_change_log_knows_the_version(project):
    assert project["project"]["version"] == version("wayside")
    log = (ROOT / "CHANGELOG.md").read_text()
    assert re.search(
        r"^## \[?(Unreleased|" + re.escape(version("wayside")) + r")\b", log, re.MULTILINE
    )


def test_the_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "wayside", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("wayside ")
