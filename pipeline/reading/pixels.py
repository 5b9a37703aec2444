"""Images of a log by their rows, decoded before it is processed; whether its camera sees colour."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from wayside.pipeline.reading.clocks import Integers
from wayside.pipeline.reading.h264 import H264
from wayside.pipeline.reading.image_headers import frame_of
from wayside.pipeline.reading.plan import Plan
from wayside.pipeline.reading.records import ScanReport
from wayside.pipeline.reading.replay import image_messages
from wayside.pipeline.reading.video import VideoStreams
from wayside.schemas.frame import Camera, Image
from wayside.stages.imaging import colorfulness, decode

_IMAGES = 9
"""Spread over the log; of a video, which is decoded from its start, the first ones."""
_COLORLESS = 0.07
"""Most colour of a grey camera's images: noise and casts give up to 0.05, colour cameras at least 0.10, in fog, too."""


def decoded_images(
    plan: Plan, rows: Integers, cameras: Sequence[Camera | None], video: VideoStreams
) -> Iterator[tuple[int, Image]]:
    """Images with their rows, in the order given; those without pixels are not used."""
    for row, message in image_messages(plan.survey, plan.camera.name, rows, ScanReport()):
        status, content = video.image(message, cameras[row])
        frame = replace(frame_of(content), status=status, camera=cameras[row])
        (image,) = decode(iter([frame]))
        yield row, image


def is_grey(plan: Plan, order: Integers, cameras: Sequence[Camera | None]) -> bool:
    """Whether none of some images shows colour, and at least one has pixels; mostly the first one tells."""
    of_video = plan.camera.image_format == H264
    places = np.arange(len(order)) if of_video else np.linspace(0, len(order) - 1, _IMAGES)
    rows = order[np.unique(places.astype(int))[:_IMAGES]]
    seen = False
    for _, image in decoded_images(plan, rows, cameras, VideoStreams()):
        if image.rgb is not None:
            seen = True
            if colorfulness(image.rgb) > _COLORLESS:
                return False
    return seen
