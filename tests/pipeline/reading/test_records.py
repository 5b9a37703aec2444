"""What is read from logs that are whole, cut, damaged or made to cost much, and what is reported as lost."""

import io
import resource
import struct
import zlib
from functools import cache

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from wayside.pipeline.reading import layout, records
from wayside.pipeline.reading.layout import Budget
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.records import (
    Attachment,
    Message,
    Metadata,
    ScanReport,
    messages_at,
    scan,
)
from wayside.schemas.errors import InputError

from .conftest import BARE, CHANNEL, HEAD, SCHEMA, record, text

COUNT = 21
KINDS = [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]
PLAIN = {"use_chunking": False}
ALL_PACKINGS = [PLAIN, *({"compression": k, "chunk_size": 900} for k in KINDS)]
END = record(15, bytes(4))


def payload(topic, index):
    """Noise, text or numbers with many zeros."""
    random = np.random.default_rng(index)
    numbers = np.where(random.random(30) < 0.5, 0.0, random.normal(size=30))
    noise = random.integers(0, 256, 200, np.uint8).tobytes()
    return (noise, b"%d " % index * 40, numbers.tobytes())[topic]


def write(**options):
    return bytearray(written(tuple(options.items())))


@cache
def written(options):
    """Three topics of a schema each."""
    stream = io.BytesIO()
    writer = Writer(stream, **dict(options))
    writer.start(library="tests")
    channels = [
        writer.register_channel(t, "json", writer.register_schema(f"T{t}", "jsonschema", b"{}"))
        for t in "abc"
    ]
    for index in range(COUNT):
        log_time = 10**18 + index * 10**8
        data = payload(index % 3, index)
        writer.add_message(channels[index % 3], log_time, data, log_time, index)
    writer.finish()
    return stream.getvalue()


def read(folder, content):
    """Numbers of the messages; each must be as it was written."""
    path = folder / "log.mcap"
    path.write_bytes(content)
    report = ScanReport()
    found = [m for m in scan(path, report) if isinstance(m, Message)]
    for m in found:
        topic = m.sequence % 3
        assert (m.channel.topic, m.channel.schema_name) == ("abc"[topic], f"T{'abc'[topic]}")
        assert bytes(m.data) == payload(topic, m.sequence)
    assert report.messages == len(found)
    return [m.sequence for m in found], report


def records_of(content):
    """Opcode, start and end of each record up to the end of the data."""
    position, found = 8, []
    while not found or found[-1][0] != 15:
        opcode, length = struct.unpack_from("<BQ", content, position)
        found.append((opcode, position, position + 9 + length))
        position += 9 + length
    return found


def chunks_of(content):
    """Offset and length of the content of each chunk."""
    return [(start, end - start - 9) for opcode, start, end in records_of(content) if opcode == 6]


def test_all_messages_come_in_file_order_whatever_the_packing(tmp_path, packing):
    content = write(**{**packing, "chunk_size": 600})
    found, report = read(tmp_path, content)
    assert found == list(range(COUNT))
    assert report.problem_count == 0
    assert report.bytes_read == report.bytes_total == len(content)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "an empty file"),
        (b"\x89MCAP0\r\n", "without any record"),
        (b"\x89MCAP0\r\n\x89MCAP0\r\n", "without any record"),
        (b"#ROSBAG V2.0\n" + bytes(50), "begins with b'#ROSBAG '"),
    ],
)
def test_what_is_no_log_is_refused_with_what_was_found(tmp_path, content, found):
    with pytest.raises(InputError, match="not an MCAP log") as error:
        read(tmp_path, content)
    assert found in str(error.value)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="Check the name"):
        list(scan(tmp_path / "none.mcap", ScanReport()))
    with pytest.raises(InputError):
        list(scan(tmp_path, ScanReport()))


@pytest.mark.parametrize("bare", [{}, BARE])
@pytest.mark.parametrize("packing", ALL_PACKINGS)
def test_a_log_cut_at_any_byte_gives_the_messages_of_its_whole_records(tmp_path, packing, bare):
    content = write(**packing, **bare)
    records = records_of(content)
    last = 0
    for size in range(17, len(content), 13):
        found, report = read(tmp_path, content[:size])
        assert found == list(range(len(found)))
        assert len(found) >= last
        assert bool(report.problem_count) == (size < records[-1][1] + 9)
        if packing is PLAIN:
            assert len(found) == sum(op == 5 and end <= size for op, _, end in records)
        last = len(found)
    assert last == COUNT


def test_a_cut_and_a_damaged_chunk_are_told_with_their_place_and_against_the_summary(tmp_path):
    content = write(chunk_size=900)
    offset, length = chunks_of(content)[2]
    _, report = read(tmp_path, content[: offset + length // 2])
    (problem,) = report.problems
    assert f"cut off {length // 2} bytes after its last complete record" in str(problem)
    assert problem.offset == offset
    content[offset + 9 + length - 20] ^= 0x10
    found, report = read(tmp_path, content)
    assert report.lost_chunks == report.problem_count == 1
    assert str(report.problems[0]).startswith(f"at byte {offset}: chunk of {length + 9} bytes lost")
    assert report.messages_stated == COUNT > len(found)


@pytest.mark.parametrize("bare", [{}, BARE])
@pytest.mark.parametrize("packing", ALL_PACKINGS[1:])
def test_a_changed_byte_costs_the_chunk_that_it_is_in(tmp_path, packing, bare):
    content = write(**packing, **bare)
    chunks = [(start, end) for opcode, start, end in records_of(content) if opcode == 6]
    for start, end in chunks[1:]:
        for place in [*range(start + 1, start + 50, 3), *range(start + 50, end, 61)]:
            changed = bytearray(content)
            changed[place] ^= 1 << place % 8
            found, report = read(tmp_path, changed)
            lost = sorted(set(range(COUNT)) - set(found))
            assert len(lost) < COUNT // 3
            assert lost == list(range(lost[0], lost[-1] + 1)) if lost else not bare or not lost
            assert report.problem_count == 1 or not lost, place


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("opcode", [*range(1, 16), 0x10, 0x26, 0x86, 0xFF])
@pytest.mark.parametrize("bare", [{}, BARE])
def test_a_chunk_whose_opcode_is_changed_is_lost_and_told(tmp_path, kind, opcode, bare):
    content = write(compression=kind, chunk_size=900, **bare)
    offset, _ = chunks_of(content)[2]
    content[offset] = opcode
    found, report = read(tmp_path, content)
    lost = COUNT - len(found)
    assert 0 < lost <= 10 if opcode != 6 else lost == 0
    assert bool(report.problem_count or report.unchecked) == bool(lost)


def test_a_message_whose_opcode_is_changed_is_lost_perhaps_with_the_one_before(tmp_path):
    content = write(**PLAIN)
    start = content.index(payload(1, 10)) - 31
    for opcode in [*range(20), 0x7F, 0x80, 0xFF]:
        content[start] = opcode
        found, report = read(tmp_path, content)
        lost = set(range(COUNT)) - set(found)
        assert {10} <= lost <= {9, 10} if opcode != 5 else not lost
        assert bool(report.problem_count) == bool(lost), opcode


@pytest.mark.parametrize("bare", [{}, BARE])
def test_a_changed_length_costs_its_record_and_one_before_where_nothing_is_chunked(tmp_path, bare):
    content = write(**PLAIN, **bare)
    for opcode, start, end in records_of(content)[:-1]:
        for byte in range(1, 9):
            for value in (0, 37, 255):
                changed = bytearray(content)
                changed[start + byte] = value
                if changed == content:
                    continue
                found, report = read(tmp_path, changed)
                lost = set(range(COUNT)) - set(found)
                if opcode == 5:
                    index = struct.unpack_from("<I", content, start + 11)[0]
                    assert {index} <= lost <= {index - 1, index}, (start, byte, value)
                elif opcode in (3, 4) and bare:
                    assert len(lost - {0}) <= COUNT // 3
                    assert "messages of channel" in str(report.problems[-1])
                assert report.problem_count >= 1 or (start, end) == (8, end)


@pytest.mark.parametrize("packing", ALL_PACKINGS)
def test_a_damaged_summary_costs_nothing(tmp_path, packing):
    content = write(**packing)
    for place in range(records_of(content)[-1][2], len(content), 17):
        changed = bytearray(content)
        changed[place] ^= 1 << place % 8
        found, report = read(tmp_path, changed)
        assert found == list(range(COUNT))
        assert report.problem_count == 0, place


def test_zeros_in_place_of_the_end_cost_what_they_cover(tmp_path):
    content = write(**PLAIN)
    half = len(content) // 2
    found, report = read(tmp_path, content[:half] + bytes(len(content) - half))
    whole = sum(op == 5 and end <= half for op, _, end in records_of(content))
    assert list(range(whole - 1)) <= found <= list(range(whole))
    assert report.problem_count


@pytest.mark.parametrize("bare", [{}, {"repeat_channels": False, "index_types": IndexType.NONE}])
def test_channels_of_a_lost_first_chunk_come_from_the_summary_or_their_messages_are_counted(
    tmp_path, bare
):
    content = write(compression=CompressionType.NONE, chunk_size=900, **bare)
    offset, length = chunks_of(content)[0]
    content[offset + 9 + length - 20] ^= 1
    found, report = read(tmp_path, content)
    first, *missing = map(str, report.problems)
    assert "checksum" in first
    if not bare:
        assert found == list(range(found[0], COUNT))
        assert not missing
    else:
        assert not found
        counts = [int(p.split(": ")[1].split()[0]) for p in missing if "messages of channel" in p]
        assert len(counts) == len(missing) == 3
        assert 15 <= sum(counts) < COUNT


def chunk(records, name=b"", packed=None, size=None, checksum=None):
    compress = {b"zstd": zstandard.compress, b"lz4": lz4.frame.compress}.get(name, bytes)
    packed = compress(records) if packed is None else packed
    checksum = zlib.crc32(records) if checksum is None else checksum
    size = len(records) if size is None else size
    head = struct.pack("<QQQI", 1, 2, size, checksum) + text(name)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def message(channel, index, data=b"{}"):
    return record(5, struct.pack("<HIQQ", channel, index, 10**18 + index, 0) + data)


DEFINED = SCHEMA + CHANNEL
FIRST, GOOD = DEFINED + message(1, 0), DEFINED + message(1, 1)


def read_made(tmp_path, *records):
    """Numbers of the messages of a log of these records."""
    path = tmp_path / "log.mcap"
    path.write_bytes(HEAD + b"".join(records))
    report = ScanReport()
    return [m.sequence for m in scan(path, report) if isinstance(m, Message)], report


@pytest.mark.parametrize(
    "bad",
    [
        chunk(FIRST, b"brotli"),
        chunk(FIRST, checksum=1),
        chunk(FIRST, size=2**60),
        chunk(FIRST, size=8 * 10**9),
        chunk(FIRST, size=len(FIRST) + 1),
        chunk(FIRST[:-1]),
        chunk(FIRST + record(5, b"short")),
        chunk(FIRST + struct.pack("<BQ", 5, 2**60), checksum=0),
        chunk(FIRST, b"zstd", FIRST),
        chunk(FIRST, b"lz4", FIRST),
        chunk(FIRST, b"zstd", zstandard.compress(bytes(50_000_000))),
        chunk(FIRST, b"lz4", lz4.frame.compress(bytes(50_000_000))),
        chunk(FIRST, b"zstd", zstandard.compress(FIRST)[:-4]),
        chunk(FIRST, b"lz4", lz4.frame.compress(FIRST)[:-20]),
        chunk(FIRST, b"\xff\xfe"),
    ],
)
def test_a_chunk_that_cannot_be_trusted_is_lost_whole_and_reading_goes_on(tmp_path, bad):
    found, report = read_made(tmp_path, bad, chunk(GOOD), END)
    assert found == [1]
    assert report.lost_chunks == report.problem_count == 1


def test_zstd_chunks_are_read_without_their_size_in_the_frame(tmp_path):
    packed = zstandard.ZstdCompressor(write_content_size=False).compress(GOOD)
    found, report = read_made(tmp_path, chunk(GOOD, b"zstd", packed), END)
    assert (found, report.problem_count) == ([1], 0)


def test_records_of_opcodes_to_come_and_private_ones_are_passed_over(tmp_path):
    later, private = record(0x10, b"later"), record(0x90, b"private" * 1000)
    records = later, SCHEMA, CHANNEL, private, message(1, 1), private, END
    found, report = read_made(tmp_path, *records)
    assert (found, report.problem_count) == ([1], 0)
    assert report.unchecked[-1] == "3 records of unknown kinds were skipped"


def test_messages_of_a_channel_whose_schema_is_missing_are_lost_and_counted(tmp_path):
    other = record(4, struct.pack("<HH", 2, 0) + text(b"/b") + text(b"json") + text(b""))
    records = CHANNEL, other, message(1, 1), message(2, 2), message(1, 3), END
    found, report = read_made(tmp_path, *records)
    assert found == [2]
    (problem,) = report.problems
    assert "2 messages of channel 1 lost" in str(problem)


def test_a_message_of_a_time_that_no_table_holds_is_lost_and_told(tmp_path):
    late = record(5, struct.pack("<HIQQ", 1, 2, 1 << 63, 0))
    found, report = read_made(tmp_path, GOOD, late, message(1, 3), END)
    assert found == [1, 3]
    assert "after the year 2116" in str(report.problems[0])


@pytest.mark.parametrize("summary", [{}, BARE])
@pytest.mark.parametrize("options", [{}, PLAIN])
def test_what_follows_the_end_mark_is_not_read_and_is_told(tmp_path, options, summary):
    content = write(**options, **summary)
    found, report = read(tmp_path, content * 2)
    assert found == list(range(COUNT))
    (problem,) = report.problems
    assert problem.offset == len(content)
    assert f"{len(content)} bytes lost: they are after the end mark" in str(problem)


@pytest.mark.parametrize("misplaced", [chunk(GOOD), record(7, bytes(6)), record(2, bytes(20))])
def test_records_that_have_no_place_in_a_chunk_are_passed_over(tmp_path, misplaced):
    found, _ = read_made(tmp_path, chunk(FIRST + misplaced + message(1, 3)), END)
    assert found == [0, 3]


def test_metadata_and_small_attachments_come_and_large_ones_do_not(new_log):
    log = new_log()
    log.writer.add_metadata("wayside", {"spacing_m": "8.0"})
    log.writer.add_attachment(0, 0, "camera.yaml", "text/yaml", b"image_width: 3")
    log.writer.add_attachment(0, 0, "map.bin", "", bytes(2_000_000))
    report = ScanReport()
    found = list(scan(log.finish(), report))
    assert [type(one) for one in found] == [Metadata, Attachment]
    assert found[0].metadata == {"spacing_m": "8.0"}
    assert found[1].data == b"image_width: 3"
    assert report.problem_count == 0


@pytest.mark.parametrize(
    ("size", "checksum"), [(2**64 - 1, 0), (2**63, 0), (2**40, 0), (5, 0), (3, 7)]
)
def test_an_attachment_whose_size_or_checksum_is_wrong_is_lost_and_told(tmp_path, size, checksum):
    body = struct.pack("<QQ", 1, 1) + text(b"a.yaml") + text(b"") + struct.pack("<Q", size)
    bad = record(9, body + b"abc" + struct.pack("<I", checksum))
    found, report = read_made(tmp_path, bad, chunk(GOOD), END)
    assert found == [1]
    assert "attachment of" in str(report.problems[0])
    assert report.problem_count == 1


def test_messages_without_a_checksum_are_known(tmp_path):
    for options, count in (
        ({"enable_crcs": False}, COUNT),
        (PLAIN, COUNT),
        ({**PLAIN, "enable_data_crcs": True}, COUNT),
        ({}, 0),
    ):
        _, report = read(tmp_path, write(**options))
        assert report.unchecked_messages == count, options
        assert len(report.unchecked) == bool(count)
    _, report = read_made(tmp_path, chunk(FIRST), message(1, 1), END)
    assert report.unchecked[0].startswith("1 of 2 messages have no checksum")


@pytest.mark.parametrize("packing", ALL_PACKINGS)
def test_the_messages_of_any_record_can_be_read_again(tmp_path, packing):
    path = tmp_path / "log.mcap"
    content = write(**packing)
    path.write_bytes(content[: len(content) // 2])
    found = [m for m in scan(path, ScanReport()) if isinstance(m, Message)]
    channels, budget = [m.channel for m in found], Budget.of(10**6)
    again = [
        (m.sequence, bytes(m.data))
        for at in dict.fromkeys(m.offset for m in found)
        for m in messages_at(log_parts(path), at, channels, budget)
    ]
    assert again == [(m.sequence, bytes(m.data)) for m in found]


def test_a_hopeless_file_cannot_fill_the_memory_with_problems(tmp_path):
    _, report = read_made(tmp_path, *[chunk(FIRST, checksum=1)] * 1000, END)
    assert report.problem_count == 1000
    assert len(report.problems) == 201


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    places=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8),
    chunked=st.booleans(),
)
@example(places=[(0.8816432034359376, 124)], chunked=True)  # a record that ends beyond 2^63
def test_no_damage_makes_reading_fail_or_delivers_damaged_chunks(tmp_path, places, chunked):
    content = write(use_chunking=chunked, chunk_size=600)
    for share, value in places:
        content[8 + int(share * (len(content) - 9))] = value
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    found = [bytes(m.data) for m in scan(path, ScanReport()) if isinstance(m, Message)]
    if chunked:
        assert set(found) <= {payload(i % 3, i) for i in range(COUNT)}


BOMBS = {
    "zeros": chunk(bytes(20_000_000), b"zstd"),
    "empty records": chunk(record(0x10, b"") * 600_000, b"zstd"),
    "empty schemas": chunk(record(3, b"") * 600_000, b"zstd"),
    "short messages": chunk(DEFINED + message(1, 0, b"") * 600_000, b"zstd"),
    "lz4": chunk(bytes(150_000_000), b"lz4"),
    "zstd": chunk(bytes(150_000_000), b"zstd"),
}


@pytest.mark.parametrize("name", sorted(BOMBS))
def test_a_chunk_that_unpacks_beyond_measure_is_lost_and_reading_goes_on(tmp_path, name):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found, report = read_made(tmp_path, BOMBS[name], chunk(GOOD), END)
    assert found == [1]
    assert report.lost_chunks == report.problem_count == 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 260_000  # kB


@pytest.mark.parametrize("name", [b"zstd", b"", b"lz4"])
def test_many_chunks_are_bounded_together_by_what_lz4_can_reach(tmp_path, monkeypatch, name):
    monkeypatch.setattr(layout, "EXTRA_BYTES", 0)
    one = chunk(DEFINED + message(1, 0, bytes(3_000_000)), name)
    found, report = read_made(tmp_path, *[one] * 30, END)
    assert report.problem_count == report.lost_chunks == 30 - len(found)
    if name == b"zstd":
        assert len(found) < 30
        assert "more than 255 times the size of the log" in str(report.problems[0])
    else:
        assert len(found) == 30


def test_chunks_that_each_reach_over_all_later_ones_do_not_cost_the_square_of_the_size(
    tmp_path, monkeypatch
):
    sizes, parse_record = [], records.parse_record
    monkeypatch.setattr(
        records, "parse_record", lambda kind, of: sizes.append(len(of)) or parse_record(kind, of)
    )

    def cost(count):
        sound = chunk(GOOD)
        step, content = len(sound) + 49, b""
        for k in range(count):
            left = step * (count - k) - len(sound) - 9 + 20  # where no record can begin
            head = struct.pack("<QQQI", 1, 2, left - 40, 1) + text(b"")
            content += sound + struct.pack("<BQ", 6, left) + head + struct.pack("<Q", left - 40)
        sizes.clear()
        read_made(tmp_path, content, bytes(99), END)
        return sum(sizes)

    assert cost(800) < 5 * cost(200)
