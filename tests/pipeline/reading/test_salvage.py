"""What is had of logs that are cut or damaged, and what is told of the rest."""

import io
import struct
from functools import cache

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.records import Message, messages_at, scan
from wayside.pipeline.reading.scan_report import ScanReport

from .conftest import BARE, chunks_of

MESSAGES, SIZE = 40, 32_000
KINDS = [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]


@cache
def payload(index):
    """Half noise, as images are, half text."""
    noise = np.random.default_rng(index).integers(0, 256, SIZE // 2, np.uint8).tobytes()
    return noise + b"%08d" % index * (SIZE // 16)


def write(schema=("foxglove.CompressedImage", "jsonschema", b"{}"), **options):
    return bytearray(written(schema, tuple(options.items())))


@cache
def written(schema, options):
    stream = io.BytesIO()
    writer = Writer(stream, **dict(options))
    writer.start(library="tests")
    channel = writer.register_channel("/image", "json", writer.register_schema(*schema))
    for index in range(MESSAGES):
        time = 10**18 + index * 10**8
        writer.add_message(channel, time, payload(index), time, index)
    writer.finish()
    return stream.getvalue()


def read(path, content):
    path.write_bytes(content)
    report = ScanReport()
    found = [m for m in scan(path, report) if isinstance(m, Message)]
    assert all(bytes(m.data) == payload(m.sequence) for m in found)
    return [m.sequence for m in found], report


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_the_whole_messages_of_a_chunk_cut_off_come(tmp_path, kind, share):
    path = tmp_path / "log.mcap"
    content = write(compression=kind, chunk_size=600_000)
    (first, _), (offset, length) = chunks_of(content)[:2]
    whole, _ = read(path, content[: first + 9 + chunks_of(content)[0][1]])
    found, report = read(path, content[: offset + 9 + int(share * length)])
    assert found == list(range(len(found)))
    in_chunk = 600_000 / SIZE
    # Of lz4 and zstd whole blocks are had, of 64 and 128 kB.
    cut_block = {KINDS[0]: 0, KINDS[1]: 2, KINDS[2]: 4}[kind]
    assert len(found) - len(whole) >= int(share * in_chunk) - 1 - cut_block
    assert report.problem_count == 1
    assert "cut off" in str(report.problems[0])
    assert report.problems[0].offset == offset


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 100, 20_000])
@pytest.mark.parametrize("missing", [True, False])
def test_bytes_missing_from_or_added_to_a_chunk_cost_no_other(tmp_path, kind, count, missing):
    path = tmp_path / "log.mcap"
    content = write(compression=kind, chunk_size=300_000, **BARE)
    intact, _ = read(path, content)
    offset, length = chunks_of(content)[2]
    middle = offset + 9 + length // 2
    content[middle : middle + (count if missing else 0)] = b"" if missing else b"\x00" * count
    found, report = read(path, content)
    assert len(intact) - len(found) <= 10
    assert report.lost_chunks == 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("opcode", [*range(1, 16), 0x10, 0x26, 0x86, 0xFF])
@pytest.mark.parametrize("bare", [False, True])
def test_a_chunk_whose_opcode_is_changed_is_lost_and_told(tmp_path, kind, opcode, bare):
    path = tmp_path / "log.mcap"
    content = write(compression=kind, chunk_size=300_000, **(BARE if bare else {}))
    offset, _ = chunks_of(content)[2]
    content[offset] = opcode
    found, report = read(path, content)
    lost = 0 if opcode == 6 else 10
    assert MESSAGES - lost <= len(found) <= MESSAGES - bool(lost)
    assert bool(report.problem_count or report.unchecked) == bool(lost)
    assert report.lost or not lost or (bare and opcode > 15)


def test_a_message_whose_opcode_is_changed_is_missed_by_the_summary(tmp_path):
    content = write(use_chunking=False)
    start = content.index(payload(20)) - 31
    for opcode in [*range(20), 0x7F, 0x80, 0xFF]:
        content[start] = opcode
        found, report = read(tmp_path / "log.mcap", content)
        lost = [20] if opcode != 5 else []
        assert found == [i for i in range(MESSAGES) if i not in lost], opcode
        assert report.lost == bool(lost), opcode


@pytest.mark.parametrize("opcode", [2, 15])
def test_a_short_message_that_calls_itself_the_end_does_not_end_the_log(tmp_path, opcode):
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False, use_statistics=False)
        writer.start(library="tests")
        schema = writer.register_schema("some.Type", "jsonschema", b"{}")
        channel = writer.register_channel("/a", "json", schema)
        for index in range(10):
            writer.add_message(channel, 10**18 + index, b"short%02d" % index, 0, index)
        writer.finish()
    content = bytearray(path.read_bytes())
    content[content.index(b"short04") - 31] = opcode
    path.write_bytes(content)
    report = ScanReport()
    found = [m.sequence for m in scan(path, report) if isinstance(m, Message)]
    assert found == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    assert report.problem_count == 1


def test_messages_without_a_checksum_are_known(tmp_path):
    path = tmp_path / "log.mcap"
    for options, count in (
        ({"enable_crcs": False}, MESSAGES),
        ({"use_chunking": False}, MESSAGES),
        ({"use_chunking": False, "enable_data_crcs": True}, MESSAGES),
        ({}, 0),
    ):
        _, report = read(path, write(**options))
        assert report.unchecked_messages == count, options
        assert len(report.unchecked) == bool(count)
    content = write(compression=KINDS[0], chunk_size=600_000)
    found, report = read(path, content[: len(content) * 2 // 3])
    assert 0 < report.unchecked_messages < len(found)
    assert report.unchecked[0].startswith(f"{report.unchecked_messages} of {len(found)} messages")


def test_messages_are_reconciled_with_the_summary(tmp_path):
    path = tmp_path / "log.mcap"
    content = write(compression=CompressionType.ZSTD, chunk_size=300_000)
    offset, length = chunks_of(content)[2]
    content[offset + 9 + length - 20] ^= 1
    found, report = read(path, content)
    assert report.messages_stated == MESSAGES
    assert report.messages == len(found) < MESSAGES


@pytest.mark.parametrize("options", [{"use_chunking": False}, *({"compression": k} for k in KINDS)])
def test_the_messages_of_any_record_can_be_read_again(tmp_path, options):
    path = tmp_path / "log.mcap"
    content = write(chunk_size=300_000, **options)
    path.write_bytes(content[: len(content) // 2])
    found = [m for m in scan(path, ScanReport()) if isinstance(m, Message)]
    channels = [m.channel for m in found]
    again = [
        m
        for at in dict.fromkeys(m.offset for m in found)
        for m in messages_at(log_parts(path), at, channels, Allowance())
    ]
    assert [(m.sequence, bytes(m.data)) for m in again] == [
        (m.sequence, bytes(m.data)) for m in found
    ]


def test_a_message_of_a_time_that_no_table_holds_is_lost_and_told(tmp_path):
    content = write(use_chunking=False)
    start = content.index(payload(20)) - 31
    content[start + 9 + 6 + 7] = 0xFF
    found, report = read(tmp_path / "log.mcap", content)
    assert 20 not in found
    assert "after the year 2116" in str(report.problems[0])


SMALL = 21
PACKINGS = [{"use_chunking": False}, *({"compression": k, "chunk_size": 900} for k in KINDS)]


def small_payload(topic, index):
    """Noise, text or numbers with many zeros."""
    random = np.random.default_rng(index)
    numbers = np.where(random.random(30) < 0.5, 0.0, random.normal(size=30))
    return (
        random.integers(0, 256, 200, np.uint8).tobytes(),
        b"%d " % index * 40,
        numbers.tobytes(),
    )[topic]


@cache
def small_log(packing, bare):
    """Three topics of a schema each."""
    stream = io.BytesIO()
    writer = Writer(stream, **PACKINGS[packing], **(BARE if bare else {}))
    writer.start(library="tests")
    channels = [
        writer.register_channel(t, "json", writer.register_schema(f"T{t}", "jsonschema", b"{}"))
        for t in "abc"
    ]
    for index in range(SMALL):
        time = 10**18 + index * 10**8
        writer.add_message(channels[index % 3], time, small_payload(index % 3, index), time, index)
    writer.finish()
    return stream.getvalue()


def read_small(path, content):
    """Numbers of the messages; each must be as it was written."""
    path.write_bytes(content)
    report = ScanReport()
    found = [m for m in scan(path, report) if isinstance(m, Message)]
    for m in found:
        topic = m.sequence % 3
        assert (m.channel.topic, m.channel.schema_name) == ("abc"[topic], f"T{'abc'[topic]}")
        assert bytes(m.data) == small_payload(topic, m.sequence)
    return [m.sequence for m in found], report


def records_of(content):
    """Opcode, start and end of each record up to the end of the data."""
    position, found = 8, []
    while not found or found[-1][0] != 15:
        opcode, length = struct.unpack_from("<BQ", content, position)
        found.append((opcode, position, position + 9 + length))
        position += 9 + length
    return found


@pytest.mark.parametrize("bare", [False, True])
@pytest.mark.parametrize("packing", range(len(PACKINGS)))
def test_a_log_cut_at_any_byte_gives_its_first_messages(tmp_path, packing, bare):
    content = small_log(packing, bare)
    records = records_of(content)
    last = 0
    for size in range(17, len(content), 13):
        found, report = read_small(tmp_path / "log.mcap", content[:size])
        assert found == list(range(len(found)))
        assert len(found) >= last
        assert report.lost == (size < records[-1][1] + 9)
        if packing == 0:
            assert len(found) == sum(op == 5 and end <= size for op, _, end in records)
        last = len(found)
    assert last == SMALL


@pytest.mark.parametrize("bare", [False, True])
@pytest.mark.parametrize("packing", range(1, len(PACKINGS)))
def test_a_changed_byte_costs_the_chunk_that_it_is_in(tmp_path, packing, bare):
    content = small_log(packing, bare)
    chunks = [(start, end) for opcode, start, end in records_of(content) if opcode == 6]
    for number, (start, end) in enumerate(chunks[1:], start=1):
        for place in [*range(start + 1, start + 50, 3), *range(start + 50, end, 61)]:
            changed = bytearray(content)
            changed[place] ^= 1 << place % 8
            found, report = read_small(tmp_path / "log.mcap", changed)
            lost = sorted(set(range(SMALL)) - set(found))
            assert len(lost) < SMALL // 3
            assert lost == list(range(lost[0], lost[-1] + 1)) if lost else not bare or not lost
            assert report.problem_count == 1 or not lost, (number, place)


@pytest.mark.parametrize("bare", [False, True])
def test_a_changed_length_costs_its_record_where_nothing_is_chunked(tmp_path, bare):
    content = small_log(0, bare)
    for opcode, start, end in records_of(content)[:-1]:
        for byte in range(1, 9):
            for value in (0, 37, 255):
                changed = bytearray(content)
                changed[start + byte] = value
                if changed == content:
                    continue
                found, report = read_small(tmp_path / "log.mcap", changed)
                lost = sorted(set(range(SMALL)) - set(found))
                if opcode == 5:
                    index = struct.unpack_from("<I", content, start + 11)[0]
                    assert lost == [index], (start, byte, value)
                elif opcode in (3, 4) and bare:
                    assert len({n % 3 for n in lost}) == 1
                    assert len(lost) == SMALL // 3
                    assert f"{len(lost)} messages of channel" in str(report.problems[-1])
                else:
                    assert lost == []
                assert report.problem_count >= 1 or (start, end) == (8, end)


@pytest.mark.parametrize("packing", range(len(PACKINGS)))
def test_a_damaged_summary_costs_nothing(tmp_path, packing):
    content = small_log(packing, False)
    end = records_of(content)[-1][2]
    for place in range(end, len(content), 17):
        changed = bytearray(content)
        changed[place] ^= 1 << place % 8
        found, report = read_small(tmp_path / "log.mcap", changed)
        assert found == list(range(SMALL))
        assert report.problem_count == 0, place


def test_zeros_in_place_of_the_end_cost_what_they_cover(tmp_path):
    content = small_log(0, False)
    records = records_of(content)
    half = len(content) // 2
    found, report = read_small(tmp_path / "log.mcap", content[:half] + bytes(len(content) - half))
    assert found == list(range(len(found)))
    assert len(found) >= sum(op == 5 and end <= half for op, _, end in records) - 1
    assert report.lost
