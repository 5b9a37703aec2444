"""Schemas and channels of a log, and where a lost definition is taken from instead."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from wayside.pipeline.reading.layout import (
    SCHEMA,
    Channel,
    LayoutError,
    Schema,
    parse_channel,
    parse_schema,
)
from wayside.pipeline.reading.summary import Summary
from wayside.pipeline.reading.well_known import is_well_known

Tell = Callable[[int, str], None]
"""Called with an offset in the file and what was found there."""


class Definitions:
    """What each channel of a log is, as far as read.

    A channel whose definition stood in a lost part is taken from the summary; else from a damaged chunk, where its
    schema equals one that was read soundly or is well known, field by field.
    """

    def __init__(self, summary: Callable[[], Summary | None], lost: Tell, remark: Tell) -> None:
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._doubtful_schemas: dict[int, Schema] = {}
        self._doubtful: dict[int, tuple[Channel, int]] = {}
        self._missing: set[int] = set()
        self._summary, self._lost, self._remark = summary, lost, remark
        self._summary_asked = False

    def know(self, channels: Iterable[Channel]) -> None:
        """Take channels and their schemas as an earlier scan of the same log found them."""
        for channel in channels:
            self.channels[channel.id] = channel
            if channel.schema is not None:
                self._schemas[channel.schema_id] = channel.schema

    def add(self, opcode: int, content: memoryview, start: int) -> None:
        """Take a schema or channel record that stands soundly at `start`."""
        try:
            if opcode == SCHEMA:
                schema = parse_schema(content)
                self._schemas[schema.id] = schema
                return
            channel = parse_channel(content, self._schemas)
        except LayoutError as error:
            kind = "schema" if opcode == SCHEMA else "channel"
            self._lost(start, f"a {kind} definition lost: {error}")
            return
        if self.channels.get(channel.id) == channel:
            return  # repeated in every chunk by some writers
        self.channels[channel.id] = channel
        if channel.schema is None and channel.schema_id:
            self._lost(
                start, f"channel {channel.topic} names schema {channel.schema_id}, which is missing"
            )

    def remember(self, records: Iterable[tuple[int, memoryview]], start: int) -> None:
        """Keep the schemas and channels among the records of a damaged chunk, for want of better ones."""
        for opcode, content in records:
            try:
                if opcode == SCHEMA:
                    schema = parse_schema(content)
                    self._doubtful_schemas.setdefault(schema.id, schema)
                else:
                    channel = parse_channel(content, self._doubtful_schemas | self._schemas)
                    self._doubtful.setdefault(channel.id, (channel, start))
            except LayoutError:
                continue

    def channel(self, channel_id: int, start: int) -> Channel | None:
        """The channel of a message that stands at `start`; None, and told once, where nothing defines it."""
        known = self.channels.get(channel_id)
        if known is not None or channel_id in self._missing:
            return known
        if not self._summary_asked:
            self._summary_asked = True
            summary = self._summary()
            for channel in () if summary is None else summary.channels.values():
                self.channels.setdefault(channel.id, channel)
        if channel_id not in self.channels:
            self._take_doubtful(channel_id, start)
        return self.channels.get(channel_id)

    def _take_doubtful(self, channel_id: int, start: int) -> None:
        channel, place = self._doubtful.get(channel_id, (None, 0))
        if channel is None or channel.schema is None or not self._is_trusted(channel.schema):
            self._missing.add(channel_id)
            self._lost(start, f"messages of channel {channel_id} lost: its definition is missing")
            return
        self.channels[channel_id] = channel
        self._remark(
            place,
            f"the definition of {channel.topic} stands in a damaged chunk only; it is used, as its schema "
            f"{channel.schema_name} is known; nothing tells whether its name is right",
        )

    def _is_trusted(self, schema: Schema) -> bool:
        alike = (s for s in self._schemas.values() if s.name == schema.name)
        return any(s.data == schema.data for s in alike) or is_well_known(schema)
