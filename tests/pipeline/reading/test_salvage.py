"""What is had of chunks that are cut, damaged or not what they call themselves."""

import io
import struct
from functools import cache

import lz4.block
import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from wayside.pipeline.reading.chunks import ChunkHead
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.records import Message, messages_at, scan
from wayside.pipeline.reading.salvage import front_of_lz4_block, unpack_front
from wayside.pipeline.reading.scan_report import ScanReport

MESSAGES, SIZE = 40, 32_000
BARE = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}
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


def chunks_of(content):
    """Offset and length of the content of each chunk."""
    position, found = 8, []
    while position < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, position)
        if opcode == 6:
            found.append((position, length))
        position += 9 + length
    return found


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
    # A block of zstd is 128 kB: at most four messages stand in one that is not complete.
    assert len(found) - len(whole) >= int(share * in_chunk) - (5 if kind is KINDS[2] else 2)
    assert report.problem_count == 1
    assert f"{len(found) - len(whole)} messages before the cut are used" in str(report.problems[0])


@pytest.mark.parametrize("known_size", [True, False])
@pytest.mark.parametrize("checksum", [True, False])
@pytest.mark.parametrize("size", [200, 60_000, 400_000])
def test_a_stored_block_of_zstd_gives_all_its_bytes_before_the_cut(size, known_size, checksum):
    noise = np.random.default_rng(1).integers(0, 256, size, np.uint8).tobytes()
    packer = zstandard.ZstdCompressor(write_content_size=known_size, write_checksum=checksum)
    packed = packer.compress(noise)
    head = ChunkHead(0, 0, size, 0, "zstd")
    largest_head = 18 + 3 * (1 + size // 2**17) + 4
    for cut in np.linspace(0, len(packed) - 1, 57).astype(int):
        front = bytes(unpack_front(head, memoryview(packed)[:cut], size))
        assert noise.startswith(front)
        assert len(front) >= cut - largest_head


@settings(max_examples=60)
@given(cut=st.integers(0, 100), junk=st.binary(max_size=60))
def test_no_bytes_make_the_front_of_zstd_fail(cut, junk):
    packed = zstandard.compress(b"abc" * 40) + zstandard.compress(bytes(range(256)))
    head = ChunkHead(0, 0, 1000, 0, "zstd")
    assert len(unpack_front(head, memoryview(packed[:cut] + junk), 1000)) <= 1000


@settings(max_examples=60)
@given(data=st.binary(max_size=3000), repeats=st.integers(1, 20), share=st.floats(0, 1))
def test_the_front_of_a_cut_lz4_block_is_a_front_of_what_it_holds(data, repeats, share):
    whole = data * repeats
    block = lz4.block.compress(whole, store_size=False)
    assert front_of_lz4_block(block, b"", len(whole) + 1) == whole
    front = front_of_lz4_block(block[: int(share * len(block))], b"", len(whole))
    assert whole.startswith(front)


@settings(max_examples=100)
@given(block=st.binary(max_size=300), before=st.binary(max_size=50))
def test_no_lz4_block_unpacks_to_more_than_it_may(block, before):
    assert len(front_of_lz4_block(block, before, 1000)) <= 1000


@pytest.mark.parametrize("linked", [True, False])
@pytest.mark.parametrize("checksums", [True, False])
@pytest.mark.parametrize("size", [lz4.frame.BLOCKSIZE_MAX64KB, lz4.frame.BLOCKSIZE_MAX256KB])
def test_lz4_frames_of_every_form_unpack_up_to_their_cut(linked, checksums, size):
    whole = b"".join(payload(i) for i in range(8))
    packed = lz4.frame.compress(
        whole, block_linked=linked, block_checksum=checksums, block_size=size
    )
    head = ChunkHead(1, 2, len(whole), 0, "lz4")
    assert unpack_front(head, memoryview(packed), len(whole)) == whole
    for cut in range(0, len(packed), 20_011):
        front = bytes(unpack_front(head, memoryview(packed)[:cut], len(whole)))
        assert whole.startswith(front)
        assert len(front) > cut - 100


@pytest.mark.parametrize("kind", KINDS)
def test_the_definitions_of_a_damaged_first_chunk_serve_the_others(tmp_path, kind):
    path = tmp_path / "log.mcap"
    content = write(compression=kind, chunk_size=600_000, **BARE)
    offset, length = chunks_of(content)[0]
    content[offset + 9 + length - 3000] ^= 0x10
    found, report = read(path, content)
    assert found == list(range(found[0], MESSAGES))
    assert 0 < found[0] <= 20
    assert report.lost_chunks == report.problem_count == 1
    assert "stands in a damaged chunk only" in str(report.remarks[0])


@pytest.mark.parametrize("change", ["name of the type", "protobuf fields", "unknown type"])
def test_a_damaged_definition_that_is_not_well_known_is_not_used(tmp_path, change):
    path = tmp_path / "log.mcap"
    schema = {
        "name of the type": ("foxglove.CompressedImage", "jsonschema", b"{}"),
        "protobuf fields": ("foxglove.CompressedImage", "protobuf", b"\x0a\x02\x0a\x00"),
        "unknown type": ("my.Type", "jsonschema", b"{}"),
    }[change]
    content = write(schema, compression=KINDS[0], chunk_size=600_000, **BARE)
    offset, length = chunks_of(content)[0]
    content[offset + 9 + length - 3000] ^= 0x10
    if change == "name of the type":
        content[content.index(b"CompressedImage")] ^= 1
    found, report = read(path, content)
    assert found == []
    assert "its definition is missing" in str(report.problems[-1])


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
@pytest.mark.parametrize("opcode", [1, 3, 5, 7, 8, 9, 12, 0x10, 0xFF])
def test_a_chunk_whose_opcode_is_changed_is_told_and_read(tmp_path, kind, opcode):
    path = tmp_path / "log.mcap"
    content = write(compression=kind, chunk_size=300_000, **BARE)
    offset, _ = chunks_of(content)[2]
    content[offset] = opcode
    found, report = read(path, content)
    assert found == list(range(MESSAGES))
    assert report.problem_count == 1


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


def test_a_log_without_checksums_is_known_to_have_none(tmp_path):
    path = tmp_path / "log.mcap"
    for options, known in (
        ({"enable_crcs": False}, False),
        ({"use_chunking": False}, False),
        ({"use_chunking": False, "enable_data_crcs": True}, True),
        ({"enable_crcs": False, "enable_data_crcs": True}, True),
        ({}, True),
    ):
        _, report = read(path, write(**options))
        assert (report.unchecked == []) is known, options


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
        for m in messages_at(log_parts(path), at, channels)
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


def test_a_first_chunk_that_calls_itself_a_message_is_read(tmp_path):
    content = write(compression=KINDS[2], chunk_size=300_000, **BARE)
    content[chunks_of(content)[0][0]] = 5
    found, report = read(tmp_path / "log.mcap", content)
    assert found == list(range(MESSAGES))
    assert report.problem_count == 1
