"""The recording of a finished run: opened in a viewer, or drawn to a PNG."""

import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rerun.experimental import ViewerClient

from wayside.pipeline.files.output_folder import RECORDING, finish_replacement
from wayside.pipeline.files.pictures import is_marked, marked_png
from wayside.pipeline.files.writing import sync, write_file
from wayside.pipeline.results.result import find_sign, read_rows, read_run, read_times
from wayside.pipeline.view import viewer
from wayside.pipeline.view.blueprint import drive_layout, sign_layout
from wayside.pipeline.view.entities import APPLICATION, FRAME, LOG
from wayside.schemas.errors import InputError, OutputError, UsageError
from wayside.schemas.tables import SIGNS

IMPORTED = "log.rrd"
"""The log itself as a recording, next to the run's own, if that holds no images."""
_MARK = "wayside picture"


@dataclass(frozen=True, slots=True)
class Target:
    """What to show: a frame of the drive, or one sign in the frame where it is largest."""

    frame: int
    log_time_ns: int
    sign: dict[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class Recordings:
    """Files that make one recording."""

    own: Path
    recording_id: str
    imported: Path | None = None
    images: str | None = None
    """Entity of the images where they come from the imported log."""

    def files(self, target: Target, folder: Path) -> list[Path]:
        """All, with a layout for the target, in the order in which the viewer keeps that layout."""
        sign = target.sign
        if sign is None:
            layout = drive_layout(self.images)
        else:
            box = tuple(sign["best_box"])
            layout = sign_layout(sign["sign_id"], sign["ahead_m"], box, self.images)
        layout.save(APPLICATION, str(folder / "layout.rbl"))
        return [self.own, folder / "layout.rbl", *([self.imported] if self.imported else [])]

    def show(self, client: ViewerClient, target: Target) -> None:
        """Go to the target; an imported log knows no frame numbers."""
        if self.images is None:
            viewer.show_time(client, FRAME, target.frame)
        else:
            viewer.show_time(client, LOG, target.log_time_ns)


def find_target(out: Path, sign_id: str | None, frame: int | None) -> Target:
    """The frame or sign asked for; where nothing is, the first frame that shows most signs.

    Raises InputError if the folder is no result, UsageError if there is no such sign or frame, or both are given.
    """
    if sign_id is not None and frame is not None:
        raise UsageError(
            "--sign and --frame are both given, but a sign has its own best frame. Leave one out."
        )
    times = read_times(out)
    if sign_id is None:
        chosen = _richest(out, times) if frame is None else frame
        if chosen not in times:
            known = f"{min(times)} to {max(times)}" if times else "none"
            raise UsageError(f"--frame {frame}: {out} does not hold this frame, but {known}")
        return Target(chosen, times[chosen])
    signs = read_rows(out, SIGNS, ["sign_id", "best_frame", "best_box", "ahead_m"])
    sign = find_sign(out, signs, sign_id)
    return Target(sign["best_frame"], times[sign["best_frame"]], sign)


def _richest(out: Path, frames: Iterable[int]) -> int:
    """The first frame that lies in the spans of most signs; the first of all where there are none."""
    signs = read_rows(out, SIGNS, ["first_frame", "last_frame"])
    spans = [(row["first_frame"], row["last_frame"]) for row in signs]
    return max(sorted(frames), key=lambda f: sum(a <= f <= b for a, b in spans), default=0)


def recordings_of(out: Path, log: Path | None) -> Recordings:
    """The recording of a result, over its log where one is given, which is imported once and kept.

    Raises InputError if the run was made without a recording or Rerun cannot import the log, UsageError if a log is
    given though the recording holds images of its own.
    """
    finish_replacement(out)
    path = out / RECORDING
    if not path.is_file():
        raise InputError(
            f"{path}: there is no recording of the run. Run the log again with `wayside run LOG --view file -o "
            f"{out}`."
        )
    run = read_run(out)
    recording_id = Path(run.get("log", out.name)).stem
    if log is None:
        return Recordings(path, recording_id)
    if run.get("view_images") != "none":
        raise UsageError(
            f"--over {log}: {path} holds images of its own and is not laid over others; leave --over out, "
            "or run the log again with --view-images none"
        )
    imported = out / IMPORTED
    if not imported.is_file():
        with tempfile.TemporaryDirectory(prefix=".wayside-", dir=out) as scratch:
            whole = Path(scratch) / IMPORTED
            viewer.import_log(log, recording_id, whole)
            sync(whole)
            os.replace(whole, imported)
    return Recordings(path, recording_id, imported, run.get("camera_topic"))


def open_result(
    out: Path, target: Target, log: Path | None, *, serve: bool, web_port: int | None = None
) -> None:
    """Open the recording in a viewer; in a window at the target. It stays open when this program ends."""
    found = recordings_of(out, log)
    with tempfile.TemporaryDirectory(prefix="wayside-") as scratch:
        files = found.files(target, Path(scratch))
        address = viewer.start_viewer(files, found.recording_id, serve=serve, web_port=web_port)
    if not serve:  # a server takes no orders about what its browsers show
        client = ViewerClient.connect(address)
        viewer.wait_until_loaded(client)
        found.show(client, target)


def save_screenshot(
    out: Path,
    target: Target,
    log: Path | None,
    png: Path,
    size: tuple[int, int],
    *,
    overwrite: bool = False,
) -> None:
    """Draw the viewer with a target to a PNG, without a display; over another such image, or with `overwrite` anything.

    Raises OutputError if there is no software Vulkan, a view cannot be drawn, or the file cannot be written.
    """
    if not png.parent.is_dir():
        raise OutputError(f"{png}: there is no folder {png.parent}. Make it first.")
    found = recordings_of(out, log)
    with tempfile.TemporaryDirectory(prefix="wayside-") as scratch:
        drawn = Path(scratch) / "drawn.png"
        files = found.files(target, Path(scratch))
        with viewer.headless(files, found.recording_id, size) as client:
            found.show(client, target)
            views = viewer.ask(client.get_state).views
            viewer.ask(lambda: client.save_screenshot(str(drawn)))
        content = marked_png(drawn.read_bytes(), _MARK)
    write_file(png, content, is_own=lambda old: is_marked(old, _MARK), overwrite=overwrite)
    reports = [(view.name, report) for view in views for report in view.reports]
    faults = [f"{name}: {report}" for name, report in reports if report.severity == "error"]
    if faults:
        raise OutputError(f"{png}: drawn, but the viewer reports {'; '.join(faults)}")
