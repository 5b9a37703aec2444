"""Numbers of the images of a log: copies, which take none, and numbers that are missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from hashlib import blake2b

_MOST_LISTED = 4


class ImageNumbers:
    """Numbers of images along the way: a copy of an earlier image takes none, since nothing was travelled for it.

    A copy agrees in every byte, which two exposures of a camera never do. 16 bytes of each image are kept.
    """

    def __init__(self) -> None:
        self._seen: set[bytes] = set()
        self._taken_by_copies = 0
        self._latest: tuple[int, str] | None = None
        self._gaps: list[tuple[int, str]] = []

    def take(self, number: int, label: str, data: memoryview) -> tuple[int, bool]:
        """Number of the image less those that copies before it took, and whether it is a copy itself."""
        digest = blake2b(data, digest_size=16).digest() if len(data) else b""
        is_copy = digest in self._seen
        if digest:
            self._seen.add(digest)
        if self._latest is not None:
            step = number - self._latest[0]
            if step > 1:
                self._gaps.append((step - 1, self._latest[1]))
            if is_copy:
                self._taken_by_copies += step
        self._latest = number, label
        return number - self._taken_by_copies, is_copy

    def notes(self) -> Iterator[str]:
        """Which numbers are missing, in words."""
        if self._gaps:
            places = [f"{count} after {label}" for count, label in self._gaps[:_MOST_LISTED]]
            more = len(self._gaps) - len(places)
            yield (
                f"missing numbers among the images: {sum(count for count, _ in self._gaps)} "
                f"({', '.join(places)}{f' and {more} more gaps' if more else ''}); the step across a gap is longer by "
                "one spacing for each"
            )


def describe_duplicates(labels: Sequence[str]) -> str:
    """A note on images of the status `duplicate`, by their names or frames."""
    more = len(labels) - _MOST_LISTED
    listed = ", ".join(labels[:_MOST_LISTED]) + (f" and {more} more" if more > 0 else "")
    return (
        f"duplicate images: {len(labels)} ({listed}); they are copies of an earlier one or show no motion since the "
        "last used one, take no part, and add nothing to the distance travelled"
    )
