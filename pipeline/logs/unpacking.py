"""Pictures of a video file as numbered images, each with its time of capture: the rest of importing knows no videos."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

from PIL import Image

from wayside.schemas.errors import InputError, UsageError

VIDEOS = frozenset((".mp4", ".mov", ".m4v", ".mkv", ".avi", ".ts"))
JPEG_QUALITY = 95
"""Less would add errors to ties."""
_DIRECTORY, _TAKEN, _FRACTION, _OFFSET = 0x8769, 0x9003, 0x9291, 0x9011
"""Tags of Exif."""


def unpack_video(
    video: Path,
    folder: Path,
    *,
    every: int = 1,
    date: datetime | None = None,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Write every n-th picture of a video into a folder, as JPEG.

    `date`: of the first picture; None: as the file states (UTC). `watch`: called with the numbers of pictures decoded
    and in all. Raises UsageError without PyAV. Raises InputError where the file holds no video, or its pictures are to
    be shown turned.
    """
    try:
        import av
    except ImportError as error:
        raise UsageError(f"{video}: videos need PyAV: pip install 'wayside[video]'.") from error
    try:
        with av.open(str(video)) as container:
            stream = container.streams.video[0]
            if date is None and (stated := container.metadata.get("creation_time")):
                date = datetime.fromisoformat(stated)
            for number, frame in enumerate(container.decode(stream)):
                if frame.rotation:
                    raise InputError(
                        f"{video}: its images are marked as rotated. Rotate them first (ffmpeg -i {video.name} "
                        "turned.mp4), and calibrate the camera with the rotated images."
                    )
                if number % every == 0:
                    taken = date and date + timedelta(seconds=float(frame.time or 0))
                    name = folder / f"{video.stem}_{number // every + 1:06d}.jpg"
                    picture = Image.fromarray(frame.to_ndarray(format="rgb24"))
                    picture.save(name, quality=JPEG_QUALITY, exif=_exif(taken))
                watch(number + 1, max(stream.frames, number + 1))
    except (av.FFmpegError, LookupError) as error:
        raise InputError(f"{video}: the video cannot be decoded: {error}") from error


def _exif(taken: datetime | None) -> Image.Exif:
    exif = Image.Exif()
    if taken is not None:
        utc = taken.astimezone(UTC) if taken.tzinfo else taken
        zone = {_OFFSET: "+00:00"} if taken.tzinfo else {}
        told = {_TAKEN: f"{utc:%Y:%m:%d %H:%M:%S}", _FRACTION: f"{utc:%f}"} | zone
        exif.get_ifd(_DIRECTORY).update(told)
    return exif
