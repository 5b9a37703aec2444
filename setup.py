"""The packages of `wayside`: its parts lie in folders at the top, which `pyproject.toml` cannot say."""

from setuptools import find_packages, setup

PARTS = ("pipeline", "schemas", "stages")

setup(
    package_dir={"wayside": "wayside"} | {f"wayside.{part}": part for part in PARTS},
    packages=["wayside"]
    + [
        f"wayside.{name}"
        for part in PARTS
        for name in (part, *find_packages(".", include=[f"{part}.*"]))
    ],
)
