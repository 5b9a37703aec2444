"""Times and positions of the messages of a log: what their order and faults are told from."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.reading.contents import Content, FixContent, ImageContent, PoseContent

Stream = tuple[str, str, str]
"""Topic, schema, and the child frame of a transform (else empty)."""

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

POSITION, ROTATION = slice(0, 3), slice(3, 7)
_NO_VALUE = (0.0,) * 7


@dataclass(slots=True)
class Stamps:
    """One row a message, and one row an entry: a content of a message, or a message without any usable one.

    offset, log_ns: of each message, in file order; first: its first entry. message, stream, header_ns (0: none),
    usable: of each entry; value: of each entry, seven numbers (`POSITION`: metres, or degrees and metres of a fix;
    `ROTATION`: quaternion), 0 where it has none.
    """

    offset: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))
    first: array[int] = field(default_factory=lambda: array("q"))
    message: array[int] = field(default_factory=lambda: array("q"))
    stream: array[int] = field(default_factory=lambda: array("q"))
    header_ns: array[int] = field(default_factory=lambda: array("q"))
    usable: array[int] = field(default_factory=lambda: array("b"))
    value: array[float] = field(default_factory=lambda: array("d"))
    streams: dict[Stream, int] = field(default_factory=dict)

    def add(
        self, topic: tuple[str, str], offset: int, log_ns: int, contents: Sequence[Content]
    ) -> None:
        """Take in a message, in file order; none of its contents: it cannot be used."""
        number = len(self.log_ns)
        self.offset.append(offset)
        self.log_ns.append(log_ns)
        self.first.append(len(self.message))
        if not contents:
            self._add_entry(number, (*topic, ""), None, False, _NO_VALUE)
        for content in contents:
            is_pose = isinstance(content, PoseContent)
            child = content.child if isinstance(content, PoseContent) and content.child else ""
            usable = is_pose or isinstance(content, FixContent | ImageContent)
            usable = usable or getattr(content, "camera", None) is not None
            self._add_entry(number, (*topic, child), content.time_ns, usable, _value(content))

    def _add_entry(
        self,
        message: int,
        stream: Stream,
        header_ns: int | None,
        usable: bool,
        value: tuple[float, ...],
    ) -> None:
        self.message.append(message)
        self.stream.append(self.streams.setdefault(stream, len(self.streams)))
        self.header_ns.append(header_ns or 0)
        self.usable.append(usable)
        self.value.extend(value)

    def forget_entries(self) -> None:
        """Keep the messages only, once all is decided that their entries tell."""
        for column in (self.log_ns, self.first, self.message, self.stream, self.header_ns):
            del column[:]
        del self.usable[:], self.value[:]

    def of_topic(self, topic: tuple[str, str]) -> list[int]:
        """Numbers of the streams of a topic."""
        return [number for stream, number in self.streams.items() if stream[:2] == topic]

    def columns(self) -> tuple[Integers, Integers, Integers, Integers, Flags, Floats]:
        """Log time (m,) of each message; message, stream, header time, usable (n,) and value (n, 7) of each entry."""
        return (
            np.array(self.log_ns, np.int64),
            np.array(self.message, np.int64),
            np.array(self.stream, np.int64),
            np.array(self.header_ns, np.int64),
            np.array(self.usable, np.bool_),
            np.array(self.value, np.float64).reshape(-1, 7),
        )


def _value(content: Content) -> tuple[float, ...]:
    if isinstance(content, PoseContent):
        return (*content.translation, *content.rotation)
    if isinstance(content, FixContent):
        fix = content.fix
        return (fix.latitude_deg, fix.longitude_deg, fix.altitude_m, 0.0, 0.0, 0.0, 0.0)
    return _NO_VALUE
