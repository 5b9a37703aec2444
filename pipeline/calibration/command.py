"""What `wayside calibrate` does: boards where a board is named, else the log of a drive."""

from __future__ import annotations

from pathlib import Path

import cv2

from wayside.pipeline.calibration.board_report import format_boards, headline, parameter_lines
from wayside.pipeline.calibration.boards import Watcher, calibrate_images
from wayside.pipeline.calibration.coverage import coverage_of, draw_coverage
from wayside.pipeline.calibration.drive_report import format_drive, not_determined
from wayside.pipeline.calibration.drive_report import headline as drive_headline
from wayside.pipeline.calibration.drive_report import parameter_lines as drive_lines
from wayside.pipeline.calibration.drives import calibrate_log
from wayside.pipeline.files.writing import refuse, write_file
from wayside.pipeline.reading.camera_file import format_camera
from wayside.schemas.errors import InputError, OutputError
from wayside.schemas.settings import Settings
from wayside.stages.calibration import Board


def calibrate_by_boards(
    paths: list[Path],
    board: Board,
    *,
    model: str,
    name: str,
    out: Path | None,
    coverage: Path | None,
    overwrite: bool,
    watch: Watcher = lambda done, total: None,
) -> str:
    """Calibrate by images of a board, write the camera and its coverage picture, and give the report.

    The picture is written next to the camera file (`camera.coverage.png`) unless `coverage` names another place.

    Raises
    ------
    UsageError, InputError, OutputError
        As the options, the images and the files are.
    """
    if out is not None and out.is_dir():
        raise OutputError(f"{out}: this is a folder. Name a file in it.")
    picture = coverage or (None if out is None else out.with_suffix(".coverage.png"))
    files = [path for path in (out, picture) if path is not None]
    _require_free(files, overwrite=overwrite)
    found = calibrate_images(paths, board, model, watch)
    if out is not None:
        comments = [f"wayside calibrate: {headline(found)}", *parameter_lines(found)]
        text = format_camera(found.calibration.camera, name, comments)
        write_file(out, text.encode(), overwrite=overwrite)
    if picture is not None:
        drawn = cv2.imencode(".png", draw_coverage(found))[1]
        write_file(picture, drawn.tobytes(), overwrite=overwrite)
    report = format_boards(found, coverage_of(found))
    written = "".join(f"\nwritten: {path}" for path in files)
    return report + written


def calibrate_by_drive(
    log: Path,
    settings: Settings,
    *,
    name: str,
    out: Path | None,
    overwrite: bool,
) -> str:
    """Calibrate by a drive, write the camera, and give the report.

    Raises
    ------
    UsageError, InputError, OutputError
        As the log and the files are; InputError where the drive does not determine the focal length.
    """
    _require_free([] if out is None else [out], overwrite=overwrite)
    found = calibrate_log(log, settings)
    if refusal := not_determined(found):
        raise InputError(refusal)
    report = format_drive(found)
    if out is None:
        return report
    comments = [f"wayside calibrate: {drive_headline(found)}", *drive_lines(found)]
    text = format_camera(found.calibration.camera, name, comments)
    write_file(out, text.encode(), overwrite=overwrite)
    return f"{report}\nwritten: {out}"


def _require_free(paths: list[Path], *, overwrite: bool) -> None:
    """Refuse, before any work is done, files that are there or whose folder is not. Raises OutputError."""
    for path in paths:
        if not path.parent.is_dir():
            raise OutputError(f"{path}: there is no folder {path.parent}. Make it first.")
        if path.exists() and not overwrite:
            raise refuse(path, "another file")
