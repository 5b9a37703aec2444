"""`wayside calibrate`: by boards if a board is named, else by the log of a drive."""

from dataclasses import replace
from pathlib import Path

import cv2

from wayside.pipeline.calibration.boards import (
    CalibratedImages,
    calibrate_images,
    draw_coverage,
    format_boards,
)
from wayside.pipeline.calibration.drives import CalibratedDrive, calibrate_log, format_drive
from wayside.pipeline.files.writing import refuse, write_file
from wayside.pipeline.reading.calibrations import format_camera
from wayside.schemas.errors import OutputError
from wayside.schemas.settings import Settings
from wayside.stages.calibration import Board

SELF_CALIBRATION = "camera.yaml"
"""The calibration by the drive, in the folder of the tables that were made with it."""
_MARK = "wayside calibrate"


def calibrate_by_boards(
    paths: list[Path],
    board: Board,
    *,
    model: str,
    name: str,
    out: Path | None,
    coverage: Path | None,
    overwrite: bool,
) -> str:
    """Calibrate by images of a board, write the camera and its coverage picture, and give the report.

    The picture is written next to the camera file (`camera.coverage.png`) unless `coverage` names another place. Raises
    UsageError, InputError and OutputError as the options, the images and the files are.
    """
    if out is not None and out.is_dir():
        raise OutputError(f"{out}: this is a folder. Name a file in it.")
    picture = coverage or (None if out is None else out.with_suffix(".coverage.png"))
    _require_free(out, picture, overwrite=overwrite)
    found = calibrate_images(paths, board, model)
    written = _write_camera(out, found, name, overwrite=overwrite)
    if picture is not None:
        drawn = cv2.imencode(".png", draw_coverage(found))[1]
        write_file(picture, drawn.tobytes(), overwrite=overwrite)
        written += f"\nwritten: {picture}"
    return format_boards(found) + written


def calibrate_by_drive(
    log: Path, settings: Settings, *, name: str, out: Path | None, overwrite: bool
) -> str:
    """Calibrate by a drive, write the camera, and give the report.

    Raises UsageError and OutputError, and InputError where the drive does not determine the focal length.
    """
    _require_free(out, overwrite=overwrite)
    found = calibrate_log(log, settings)
    found.require_determined()
    return format_drive(found) + _write_camera(out, found, name, overwrite=overwrite)


def self_calibrated(log: Path, folder: Path, settings: Settings, *, overwrite: bool) -> Settings:
    """The settings with a calibration by the drive itself, which is written into the folder of its result, made before.

    Raises as `calibrate_by_drive`.
    """
    found = calibrate_log(log, settings)
    found.require_determined()
    file = folder.absolute() / SELF_CALIBRATION
    _write_camera(file, found, "camera", overwrite=overwrite)
    return replace(settings, read=replace(settings.read, calibration=str(file)))


def _write_camera(
    out: Path | None, found: CalibratedImages | CalibratedDrive, name: str, *, overwrite: bool
) -> str:
    """Write the camera with its parameters as comments; returns words on what was written."""
    if out is None:
        return ""
    comments = [f"{_MARK}: {found.headline}", *found.parameter_lines()]
    text = format_camera(found.calibration.camera, name, comments)
    write_file(out, text.encode(), is_own=_is_own, overwrite=overwrite)
    return f"\nwritten: {out}"


def _is_own(file: Path) -> bool:
    return file.read_bytes().startswith(f"# {_MARK}".encode())


def _require_free(*paths: Path | None, overwrite: bool) -> None:
    """Refuse, before any work is done, files that exist or whose folder does not exist. Raises OutputError."""
    for path in paths:
        if path is not None and not path.parent.is_dir():
            raise OutputError(f"{path}: there is no folder {path.parent}. Make it first.")
        if path is not None and path.exists() and not overwrite:
            raise refuse(path, "another file")
