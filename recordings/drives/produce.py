"""Renders a drive: frames in parallel, then the log and the truth, all put in place at the end."""

import json
import multiprocessing
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import cv2

from recordings.drives.alignment import build_alignment
from recordings.drives.arrays import Bytes
from recordings.drives.camera import CameraModel
from recordings.drives.layout.build import build_scene
from recordings.drives.logs import write_log
from recordings.drives.poses import drive_poses
from recordings.drives.render import Renderer
from recordings.drives.sensor import exposures
from recordings.drives.spec import DriveSpec
from recordings.drives.stamps import Output, write_stamp
from recordings.drives.truth import drive_truth
from recordings.drives.views import FrameViews, frame_views
from wayside.schemas.errors import UsageError

RenderedFrame: TypeAlias = tuple[bytes | Bytes, FrameViews]
"""An image, as JPEG or bgr8 array, and what it shows."""


class RenderedDrive:
    """One drive, ready to render its frames in any order."""

    def __init__(self, spec: DriveSpec) -> None:
        self.spec = spec
        self.road = build_alignment(spec.road, spec.path.heading_deg)
        self.poses = drive_poses(spec, self.road)
        end_m = float(self.road.station[-1])
        if self.poses[-1].station_m > end_m:
            raise UsageError(
                f"{spec.name}: the drive is {self.poses[-1].station_m:.0f} m long, but the road only {end_m:.0f} m. "
                "Render fewer frames, or lengthen road.segments."
            )
        self.camera = CameraModel(spec.camera)
        self.scene = build_scene(spec, self.road, self.poses)
        self.exposures = exposures(spec, len(self.poses))
        self.renderer = Renderer(spec, self.scene, self.camera)

    def frame(self, index: int, masks: Path | None) -> RenderedFrame:
        """One frame; its mask goes into the folder `masks`, if there is one."""
        pose = self.poses[index]
        seconds = (pose.time_ns - self.spec.log.start_ns) * 1e-9
        rendered = self.renderer.render(pose, seconds, self.exposures[index])
        views = frame_views(self.scene, pose, seconds, self.camera, rendered.visible)
        if masks is not None:
            labels = self.renderer.distorted_labels(rendered.labels)
            cv2.imwrite(str(masks / f"{index:04d}.png"), labels)
        if self.spec.log.raw:
            return rendered.image, views
        return _jpeg(rendered.image, self.spec.sensor.jpeg_quality), views


def _jpeg(image: Bytes, quality: int) -> bytes:
    options = [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    ]
    return cv2.imencode(".jpg", image, options)[1].tobytes()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep OpenCV from spreading over the processors, as the jobs do that."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _share(spec: DriveSpec, masks: Path | None, indices: Sequence[int]) -> list[RenderedFrame]:
    """Some frames of a drive, made in a process of their own."""
    with _one_thread():
        drive = RenderedDrive(spec)
        return [drive.frame(index, masks) for index in indices]


def _frames(drive: RenderedDrive, masks: Path | None, jobs: int) -> list[RenderedFrame]:
    """All frames of a drive in order, made by so many processes."""
    count = drive.spec.frames
    jobs = min(jobs, count)
    if jobs == 1:
        return [drive.frame(index, masks) for index in range(count)]
    shares = [(drive.spec, masks, range(job, count, jobs)) for job in range(jobs)]
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        results = pool.starmap(_share, shares, chunksize=1)
    return [results[index % jobs][index // jobs] for index in range(count)]


def render(spec: DriveSpec, output: Output, jobs: int = 1) -> None:
    """Render one drive into a folder.

    Everything is made in a folder of its own and moved into place at the end, the stamp last. An interrupted render
    leaves no half drive that looks whole.
    """
    output.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{spec.name}-", dir=output.folder) as name:
        made = replace(output, folder=Path(name))
        masks = made.path(spec, "masks") if output.masks else None
        if masks is not None:
            masks.mkdir()
        with _one_thread():
            drive = RenderedDrive(spec)
            frames = _frames(drive, masks, jobs)
        _write(drive, frames, made)
        if output.pictures:
            _write_images(frames, made.path(spec, "pictures"))
        output.path(spec, "stamp").unlink(missing_ok=True)
        for path in sorted(made.folder.iterdir()):
            _put(path, output.folder / path.name)
    write_stamp(spec, output)


def _write(drive: RenderedDrive, frames: Sequence[RenderedFrame], output: Output) -> None:
    """Log and truth of a drive."""
    spec, views = drive.spec, [view for _, view in frames]
    log = output.path(spec, "mcap")
    write_log(log, spec, drive.poses, (pixels for pixels, _ in frames))
    truth = drive_truth(spec, drive.scene, drive.poses, drive.exposures, views)
    text = json.dumps(truth, separators=(",", ":")) + "\n"
    output.path(spec, "truth.json").write_text(text, encoding="utf-8", newline="\n")


def _write_images(frames: Sequence[RenderedFrame], folder: Path) -> None:
    """Images as files: JPEG as they stand in the log, raw ones as PNG."""
    folder.mkdir()
    for index, (pixels, _) in enumerate(frames):
        if isinstance(pixels, bytes):
            (folder / f"{index:04d}.jpg").write_bytes(pixels)
        else:
            cv2.imwrite(str(folder / f"{index:04d}.png"), pixels)


def _put(source: Path, target: Path) -> None:
    """Move a file or folder over an older one."""
    if target.is_dir():
        shutil.rmtree(target)
    source.replace(target)
