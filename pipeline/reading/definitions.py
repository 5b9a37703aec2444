"""Schemas and channels of a log, and where a lost definition is taken from instead."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress

from mcap.opcode import Opcode

from wayside.pipeline.reading.layout import Channel, LayoutError, Schema, parse_record
from wayside.pipeline.reading.summary import Summary


class Definitions:
    """What each channel of a log is, as far as read; `tell` is called with an offset and what is wrong there.

    A sound summary tells what is not read yet, or lost. Where it has a checksum, it also counts before records that
    have none. A channel whose schema is missing is not defined.
    """

    def __init__(self, tell: Callable[[int, str], None]) -> None:
        self.channels: dict[int, Channel] = {}
        self._tell = tell
        self._schemas: dict[int, Schema] = {}
        self._stated: dict[int, Channel] = {}
        self._lost: dict[int, tuple[int, int]] = {}

    def know(self, channels: Iterable[Channel]) -> None:
        """Take channels as an earlier scan of the same log has them."""
        self.channels.update((channel.id, channel) for channel in channels)
        self._schemas.update((c.schema_id, c.schema) for c in self.channels.values() if c.schema)

    def expect(self, summary: Summary) -> None:
        """Take the definitions of a summary, those that can be parsed."""
        for opcode, content in summary.definitions:
            with suppress(LayoutError):
                self.add(opcode, content, summary.start, checked=True)
        if summary.checked:
            self._stated = dict(self.channels)

    def add(self, opcode: int, content: memoryview, start: int, *, checked: bool) -> None:
        """Take a schema or channel record that stands at `start`; `checked`: its bytes have a checksum.

        Raises
        ------
        LayoutError
            Its content contradicts its lengths.
        """
        record, _ = parse_record(opcode, content)
        if opcode == Opcode.SCHEMA:
            self._schemas[record.id] = record
            return
        schema = self._schemas.get(record.schema_id)
        channel = Channel(
            record.id, record.topic, record.message_encoding, record.schema_id, schema
        )
        stated = self._stated.get(channel.id, channel)
        if stated != channel and not checked:
            what = f"the definition of channel {channel.id} differs from the one in the summary"
            self._tell(start, f"{what}, which is used")
            channel = stated
        if schema is None and channel.schema_id:
            self.channels.pop(channel.id, None)
        elif self.channels.get(channel.id) != channel:  # some writers repeat it in every chunk
            self.channels[channel.id] = channel

    def lose_message(self, channel_id: int, start: int) -> None:
        """Count a message at `start` of a channel that is not defined."""
        first, count = self._lost.get(channel_id, (start, 0))
        self._lost[channel_id] = first, count + 1

    def tell_lost(self) -> None:
        """Tell of the messages that were counted, channel by channel."""
        for channel_id, (start, count) in self._lost.items():
            self._tell(
                start,
                f"{count} messages of channel {channel_id} lost: its definition, or that of its schema, is missing",
            )
