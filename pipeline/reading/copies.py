"""Images that a log holds more than once, byte for byte."""

from __future__ import annotations

from hashlib import blake2b


class ImageNumbers:
    """Numbers of images along the way: a copy of an earlier image takes none, since nothing was travelled for it.

    It keeps 16 bytes of each image. Two exposures of a camera never agree in every byte.
    """

    def __init__(self) -> None:
        self._seen: set[bytes] = set()
        self._taken_by_copies = 0
        self._latest: int | None = None

    def take(self, number: int, data: memoryview) -> tuple[int, bool]:
        """Number of the image less those that copies before it took, and whether it is a copy itself."""
        digest = blake2b(data, digest_size=16).digest() if len(data) else b""
        is_copy = digest in self._seen
        if is_copy and self._latest is not None:
            self._taken_by_copies += number - self._latest
        if digest:
            self._seen.add(digest)
        self._latest = number
        return number - self._taken_by_copies, is_copy
