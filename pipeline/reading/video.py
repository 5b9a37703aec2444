"""Pictures of a video, decoded one after the other, because each depends on earlier ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from wayside.pipeline.reading.contents import ContentError, ImageContent
from wayside.pipeline.reading.h264 import H264, SequenceSet, read_stream
from wayside.pipeline.reading.messages import Decoders
from wayside.pipeline.reading.records import Message
from wayside.schemas.frame import NO_KEY_FRAME, UNDECODABLE, USED, WRONG_SIZE, Camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MOST_STREAMS = 4
_BOTH_WAYS = "both ways"
"""Status of B-pictures, before they are counted."""
_BLOCK = 32
"""Pixels that a coded picture may be larger than the one shown: two rows of macroblocks, of a frame of two fields."""


class VideoStreams:
    """Decodes the pictures of the streams of one topic, each stream by itself.

    A stream is the pictures of one channel and one `frame_id`. Two cameras may share a topic, but the pictures of one
    are no references for the other. Of the newest `_MOST_STREAMS` the state is kept; another waits for a key frame
    again.
    """

    def __init__(self) -> None:
        self.without_key, self.both_ways = 0, 0
        self._messages = Decoders()
        self._decoders: dict[tuple[int, str], _Decoder] = {}
        self._streams = 0

    def image(
        self, message: Message, camera: Camera | None, *, after_loss: bool = False
    ) -> tuple[str, ImageContent]:
        """Status of the image of a message, and what is known of it; of a video as of `decode`."""
        try:
            (image,) = self._messages.decode(message.channel, message.data)
        except ContentError:
            return UNDECODABLE, ImageContent(None, "", "", memoryview(b""))
        assert isinstance(image, ImageContent)
        if image.encoding != H264:
            return USED, image
        size = None if camera is None else (camera.width, camera.height)
        return self.decode(message.channel.id, image, size, after_loss=after_loss)

    def decode(
        self, channel: int, image: ImageContent, size: tuple[int, int] | None, *, after_loss: bool
    ) -> tuple[str, ImageContent]:
        """Status of a picture, and what of it is known: rows of rgb8 where it is `used`.

        size: of the pictures to decode; others are `wrong_size`. after_loss: something of the log before it was lost,
        which may have been pictures of any stream.
        """
        if after_loss:
            for one in self._decoders.values():
                one.reference = None
        key = channel, image.frame_id
        self._streams += key not in self._decoders
        decoder = self._decoders.pop(key, None) or _Decoder()
        self._decoders[key] = decoder
        if len(self._decoders) > _MOST_STREAMS:
            del self._decoders[next(iter(self._decoders))]
        status, image = decoder.decode(image, size)
        self.without_key += status == NO_KEY_FRAME
        self.both_ways += status == _BOTH_WAYS
        return (UNDECODABLE if status == _BOTH_WAYS else status), image

    def notes(self) -> list[str]:
        """What of the video has no picture, in words."""
        words = []
        if self._streams > 1:
            several = "more" if self._streams > _MOST_STREAMS else str(self._streams)
            words.append(
                f"the topic of the video holds {several} streams, of several channels or frames of reference: each is "
                "decoded by itself, and all are taken for images of one camera"
            )
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


class _Decoder:
    """Decodes the pictures of one H.264 stream in their order.

    Nothing is decoded before the first key frame. Where numbers of the pictures show that one is missing, or one does
    not decode, the decoder would return wrong pictures silently. No picture is given until the next key frame. Pictures
    that refer to later ones (B) are not decoded: `foxglove.CompressedVideo` excludes them.
    """

    def __init__(self) -> None:
        self._context: Any = None
        self._sequence: SequenceSet | None = None
        self.reference: int | None = None
        """Number of the last picture that others refer to; None: wait for a key frame."""

    def decode(self, image: ImageContent, size: tuple[int, int] | None) -> tuple[str, ImageContent]:
        """Status of a picture, and what of it is known, as of `VideoStreams.decode`; or `_BOTH_WAYS`."""
        reference, self.reference = self.reference, None
        try:
            self._sequence, head = read_stream(image.data, self._sequence)
        except ValueError:
            return UNDECODABLE, image
        sequence = self._sequence
        if sequence is None or head is None or head.both_ways:
            self.reference = reference
            return (_BOTH_WAYS if head else NO_KEY_FRAME), image
        if not head.key:
            # Every picture since the last that was decoded was there, and this one was not.
            rises = reference is not None and (head.number - reference) % sequence.modulus == 1
            if reference is None or not (rises or sequence.gaps):
                return NO_KEY_FRAME, image
        if size not in (None, sequence[:2]):
            return WRONG_SIZE, image
        if head.key:
            self._context = _new_context(sequence)
        pixels = self._pixels(image)
        if pixels is None:
            return UNDECODABLE, image
        self.reference = head.number if head.referred else reference
        height, width, _ = pixels.shape
        rows = pixels.reshape(-1).data
        return USED, ImageContent(image.time_ns, image.frame_id, "rgb8", rows, width, height)

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


def _new_context(sequence: SequenceSet) -> Any:
    """A decoder that gives each picture at once, in one thread, and none larger than the sequence set says.

    A stream may hold several sequence sets and mean another one than the last.
    """
    import av

    context = av.CodecContext.create(H264, "r")
    context.options = {"max_pixels": str((sequence.width + _BLOCK) * (sequence.height + _BLOCK))}
    context.flags |= av.codec.context.Flags.low_delay
    context.thread_count = 1
    return context
