"""The recording of a finished run: opened in a viewer, or drawn to a PNG."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from rerun.experimental import ViewerClient

from wayside.pipeline.result import read_rows
from wayside.pipeline.run import RECORDING
from wayside.pipeline.view.blueprint import drive_layout, sign_layout
from wayside.pipeline.view.entities import APPLICATION, FRAME
from wayside.pipeline.view.viewer import (
    headless,
    show_frame,
    start_viewer,
    view_errors,
    wait_until_loaded,
)
from wayside.schemas.errors import InputError, OutputError, UsageError
from wayside.schemas.tables import FRAMES, SIGNS


@dataclass(frozen=True, slots=True)
class Target:
    """What to look at: a frame of the drive, or one sign in the frame where it is largest."""

    frame: int
    sign: dict[str, Any] | None = None


def find_target(out: Path, sign_id: str | None, frame: int | None) -> Target:
    """The frame or sign asked for; the first frame where nothing is.

    Raises
    ------
    InputError
        The folder is no result.
    UsageError
        There is no such sign or frame; both are given.
    """
    if sign_id is not None and frame is not None:
        raise UsageError("wanted --sign or --frame, found both; a sign has its own best frame")
    if sign_id is None:
        frames = [row["frame"] for row in read_rows(out, FRAMES, ["frame"])]
        if frame is not None and frame not in frames:
            known = f"{min(frames)} to {max(frames)}" if frames else "none"
            raise UsageError(f"--frame {frame}: wanted a frame of {out}, which holds {known}")
        return Target(frame if frame is not None else min(frames, default=0))
    rows = read_rows(out, SIGNS, ["sign_id", "best_frame", "best_box", "ahead_m"])
    by_id = {row["sign_id"]: row for row in rows}
    if sign_id not in by_id:
        near = get_close_matches(sign_id, by_id, n=1, cutoff=0.0)
        offered = f"; did you mean {near[0]}?" if near else ""
        raise UsageError(f"--sign {sign_id}: {out} has no such sign among {len(by_id)}{offered}")
    return Target(by_id[sign_id]["best_frame"], by_id[sign_id])


def recording_of(out: Path) -> Path:
    """The recording of a result; raises InputError where it was made without."""
    path = out / RECORDING
    if not path.is_file():
        raise InputError(
            f"{path}: wanted the recording of a run, found none; "
            f"run the log again with `wayside run LOG --view file -o {out}`"
        )
    return path


def open_result(out: Path, target: Target, *, serve: bool) -> str:
    """Open the recording in a viewer at a target; the viewer's address. It stays open when this program ends."""
    with tempfile.TemporaryDirectory(prefix="wayside-") as scratch:
        files = [recording_of(out), _layout(target, Path(scratch))]
        _, address = start_viewer(files, serve=serve)
        if not serve:
            client = ViewerClient.connect(address)
            wait_until_loaded(client)
            show_frame(client, FRAME, target.frame)
    return address


def save_picture(out: Path, target: Target, png: Path, size: tuple[int, int]) -> None:
    """Draw the viewer with a target to a PNG, without a display.

    Raises
    ------
    OutputError
        There is no software Vulkan, the file cannot be written, or a view could not be drawn.
    """
    if not png.parent.is_dir():
        raise OutputError(f"{png}: wanted a folder that is there, found none; make {png.parent}")
    with tempfile.TemporaryDirectory(prefix="wayside-") as scratch:
        files = [recording_of(out), _layout(target, Path(scratch))]
        with headless(files, size) as client:
            show_frame(client, FRAME, target.frame)
            faults = view_errors(client)
            client.save_screenshot(str(png.resolve()))
    if faults:
        raise OutputError(f"{png}: drawn, but the viewer reports {'; '.join(faults)}")


def _layout(target: Target, folder: Path) -> Path:
    path = folder / "layout.rbl"
    row = target.sign
    layout = (
        drive_layout()
        if row is None
        else sign_layout(row["sign_id"], row["ahead_m"], tuple(row["best_box"]))
    )
    layout.save(APPLICATION, str(path))
    return path
