"""Where a recording goes: a file next to the tables, or a viewer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import rerun as rr

from wayside.pipeline.files.output_folder import RECORDING
from wayside.pipeline.reading.frames import ReadReport
from wayside.pipeline.view.blueprint import drive_layout
from wayside.pipeline.view.entities import APPLICATION, image_plane
from wayside.pipeline.view.observer import RerunObserver
from wayside.pipeline.view.recorder import Recorder
from wayside.schemas.models import GaussianModel

FILE_PATIENCE_S = 30.0
"""A disk that takes nothing for so long is taken for full or gone."""


@dataclass(frozen=True, slots=True)
class Viewing:
    """What to record and where to: a file of the output folder, a viewer's address, both or neither.

    images: `all` images, those of `signs`, or `none`; detail: label images of both passes of segmentation, too.
    """

    file: bool = False
    address: str | None = None
    images: str = "all"
    detail: bool = False

    @property
    def wanted(self) -> bool:
        """Whether there is anything to do."""
        return self.file or self.address is not None


def open_observer(
    viewing: Viewing, folder: Path, log: str, location: GaussianModel, report: ReadReport
) -> RerunObserver:
    """Start the recordings of a run; `folder` exists, `log` is the name of the recording, `report` what reading chose.

    A recording without images is laid over those of the log: in the coordinate frame that Rerun's importer
    gives them.
    """
    plane = image_plane(report.camera_frame) if viewing.images == "none" else None
    recorders = []
    if viewing.file:
        path = folder / RECORDING
        recorders.append(Recorder(RECORDING, _file_stream(log, path), FILE_PATIENCE_S))
    if viewing.address is not None:
        recorders.append(Recorder(viewing.address, _live_stream(log, viewing.address), 0.0))
    return RerunObserver(
        recorders, location, images=viewing.images, detail=viewing.detail, plane=plane
    )


def _file_stream(log: str, path: Path) -> Callable[[], rr.RecordingStream]:
    def open_stream() -> rr.RecordingStream:
        stream = rr.RecordingStream(APPLICATION, recording_id=log)
        stream.save(path, default_blueprint=drive_layout())
        return stream

    return open_stream


def _live_stream(log: str, address: str) -> Callable[[], rr.RecordingStream]:
    def open_stream() -> rr.RecordingStream:
        stream = rr.RecordingStream(APPLICATION, recording_id=log)
        stream.connect_grpc(address, default_blueprint=drive_layout(live=True))
        return stream

    return open_stream
