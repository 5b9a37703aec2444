"""Pictures of a video, decoded one after the other, as each is told by those before it."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from wayside.pipeline.reading.contents import ImageContent
from wayside.pipeline.reading.h264 import H264, PictureHead, SequenceSet, read_stream
from wayside.schemas.frame import NO_KEY_FRAME, UNDECODABLE, USED

if TYPE_CHECKING:
    from numpy.typing import NDArray

WITHOUT_DECODER = (
    "wanted PyAV to decode the H.264 video, found it not installed; pip install 'wayside[video]'"
)


def can_decode_video() -> bool:
    """Whether PyAV is installed."""
    return find_spec("av") is not None


class VideoDecoder:
    """Decodes the pictures of one H.264 stream in their order.

    Nothing is decoded before the first key frame. Where the numbers of the pictures tell that one is missing, or one
    does not decode, the decoder would go on with pictures that are wrong without saying so: none is given up to the
    next key frame. Pictures that refer to later ones (B) are not decoded: `foxglove.CompressedVideo` excludes them.
    """

    def __init__(self) -> None:
        self._context: Any = None
        self._sequence: SequenceSet | None = None
        self._reference: int | None = None
        """Number of the last picture that others refer to; None: wait for a key frame."""
        self.without_key = 0
        self.both_ways = 0

    def decode(self, image: ImageContent, *, after_loss: bool = False) -> tuple[str, ImageContent]:
        """Status of a picture, and what of it is known: rows of rgb8 where it is `used`.

        after_loss: something of the log before it was lost, which may have been pictures.
        """
        if after_loss:
            self._reference = None
        try:
            self._sequence, head = read_stream(image.data, self._sequence)
        except ValueError:
            return self._fail(), image
        if head is not None and head.both_ways:
            self.both_ways += 1
            return UNDECODABLE, image
        if head is None or not (head.key or self._follows(head)):
            if head is not None:
                self._reference = None
            self.without_key += 1
            return NO_KEY_FRAME, image
        if head.key:
            self._context = _new_context()
        pixels = self._pixels(image)
        if pixels is None:
            return self._fail(), image
        if head.referred:
            self._reference = head.number
        height, width, _ = pixels.shape
        rows = pixels.reshape(-1).data
        return USED, ImageContent(image.time_ns, image.frame_id, "rgb8", rows, width, height)

    def notes(self) -> list[str]:
        """What of the video has no picture, in words."""
        words = []
        if self.without_key:
            words.append(
                f"images of the video without a key frame before them, or behind a missing one: {self.without_key} "
                f"(status {NO_KEY_FRAME}); they take no part"
            )
        if self.both_ways:
            words.append(
                f"B-pictures in the video: {self.both_ways}; they refer to later images, which the schema excludes, "
                "and are not decoded: encode without them (x264: bframes=0)"
            )
        return words

    def _follows(self, head: PictureHead) -> bool:
        """Whether every picture between the last that was decoded and this one was there."""
        if self._reference is None or self._sequence is None:
            return False
        step = (head.number - self._reference) % self._sequence.modulus
        return step <= 1 or self._sequence.gaps

    def _fail(self) -> str:
        self._reference = None
        return UNDECODABLE

    def _pixels(self, image: ImageContent) -> NDArray[Any] | None:
        import av

        try:
            frames = self._context.decode(av.Packet(bytes(image.data)))
        except av.FFmpegError:
            return None
        if len(frames) != 1 or frames[0].is_corrupt:
            return None
        pixels: NDArray[Any] = frames[0].to_ndarray(format="rgb24")
        return pixels


def _new_context() -> Any:
    """A decoder that gives each picture at once, in one thread."""
    import av

    context = av.CodecContext.create(H264, "r")
    context.flags |= av.codec.context.Flags.low_delay
    context.thread_count = 1
    return context
