"""Stamps: what a rendered drive was made from, so that it need not be made again."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from recordings.drives import RENDERER_VERSION
from recordings.drives.spec import DriveSpec


@dataclass(frozen=True, slots=True)
class Output:
    """Folder of a drive, and the files to be made there besides its log and its truth."""

    folder: Path
    masks: bool = False
    pictures: bool = False

    def path(self, spec: DriveSpec, suffix: str) -> Path:
        """File or folder of a drive: `mcap`, `truth.json`, `stamp`, `masks` or `pictures`."""
        return self.folder / f"{spec.name}.{suffix}"

    def extras(self) -> list[str]:
        """Suffixes of the folders that are wanted."""
        return [name for name in ("masks", "pictures") if getattr(self, name)]


def digest(spec: DriveSpec) -> str:
    """Hash of all that decides the bytes of a drive: settings, renderer, OpenCV and numpy."""
    settings = asdict(spec)
    if not spec.signs.varied_posts:
        del settings["signs"]["varied_posts"]  # younger than drives that are kept
    made_from = {
        "settings": settings,
        "renderer": RENDERER_VERSION,
        "opencv": cv2.__version__,
        "numpy": np.__version__,
    }
    return hashlib.sha256(json.dumps(made_from, sort_keys=True).encode()).hexdigest()


def write_stamp(spec: DriveSpec, output: Output) -> None:
    """Note that a drive is complete."""
    line = " ".join([digest(spec), *output.extras()])
    output.path(spec, "stamp").write_text(line + "\n", encoding="utf-8")


def is_complete(spec: DriveSpec, output: Output) -> bool:
    """Whether a folder holds all that is wanted of a drive, made from the same."""
    wanted = ["mcap", "truth.json", "stamp", *output.extras()]
    if not all(output.path(spec, suffix).exists() for suffix in wanted):
        return False
    noted, *extras = output.path(spec, "stamp").read_text(encoding="utf-8").split() or [""]
    return noted == digest(spec) and set(output.extras()) <= set(extras)
