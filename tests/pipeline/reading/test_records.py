import struct
import zlib
from functools import cache

import lz4.frame
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, IndexType, Writer

from wayside.pipeline.reading.records import Attachment, Message, Metadata, scan
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.schemas.errors import InputError

from .conftest import BARE, CHANNEL, HEAD, SCHEMA, chunks_of, record, text

MESSAGES = 40


@cache
def payload(index):
    return bytes((index * 7 + k) % 251 for k in range(100 + index))


def write(path, **options):
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(library="tests")
        schema = writer.register_schema("some.Type", "jsonschema", b"{}")
        channels = [writer.register_channel(topic, "json", schema) for topic in ("/a", "/b")]
        for index in range(MESSAGES):
            time = 10**18 + index * 10**8
            writer.add_message(channels[index % 2], time, payload(index), time, index)
        writer.finish()
    return path


def read(path):
    report = ScanReport()
    found = [r for r in scan(path, report) if isinstance(r, Message)]
    return [(m.channel.topic, m.sequence, bytes(m.data)) for m in found], report


def everything():
    return [("/ab"[:1] + "ab"[i % 2], i, payload(i)) for i in range(MESSAGES)]


def flip_a_bit(path, number):
    """Changes a bit near the end of a chunk, whose offset it returns."""
    content = bytearray(path.read_bytes())
    offset, length = chunks_of(content)[number]
    content[offset + 9 + length - 20] ^= 0x10
    path.write_bytes(content)
    return offset


def test_all_messages_come_in_file_order_whatever_the_packing(tmp_path, packing):
    found, report = read(write(tmp_path / "log.mcap", **{**packing, "chunk_size": 600}))
    assert found == everything()
    assert not report.lost
    assert report.messages == MESSAGES
    assert report.bytes_read == report.bytes_total == (tmp_path / "log.mcap").stat().st_size
    assert report.first_log_ns == 10**18
    assert report.last_log_ns == 10**18 + (MESSAGES - 1) * 10**8


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
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not an MCAP log") as error:
        read(path)
    assert found in str(error.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="Check the name"):
        read(tmp_path / "none.mcap")


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(InputError):
        read(tmp_path)


@pytest.mark.parametrize("kind", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_a_truncated_log_with_chunks_yields_all_complete_chunks_and_the_front_of_the_last(
    tmp_path, kind
):
    content = write(tmp_path / "log.mcap", compression=kind, chunk_size=900).read_bytes()
    ends = [offset + 9 + length for offset, length in chunks_of(content)]
    cut, whole = tmp_path / "cut.mcap", {0: 0}
    for n, end in enumerate(ends, 1):
        cut.write_bytes(content[:end])
        with cut.open("rb") as stream:  # the stock reader as the reference for what a chunk holds
            reader, count = NonSeekingReader(stream), 0
            try:
                for _ in reader.iter_messages(log_time_order=False):
                    count += 1
            except EndOfFile:
                pass
        whole[n] = count
    assert whole[len(ends)] == MESSAGES
    for size in range(17, ends[-1] + 1, 23):
        cut.write_bytes(content[:size])
        found, report = read(cut)
        assert found == everything()[: len(found)]
        assert len(found) >= whole[sum(end <= size for end in ends)]
        if kind is CompressionType.NONE:  # the whole messages of the cut chunk, too
            assert len(found) == sum(content.index(payload(i)) + 100 + i <= size for i in range(40))
        assert report.lost


@pytest.mark.parametrize("kind", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_a_flipped_bit_costs_one_chunk_and_is_counted(tmp_path, kind):
    path = write(tmp_path / "log.mcap", compression=kind, chunk_size=600)
    offset = flip_a_bit(path, 2)
    found, report = read(path)
    assert report.lost_chunks == report.problem_count == 1
    assert f"at byte {offset}" in str(report.problems[0])
    assert "lost: " in str(report.problems[0])
    lost = [one for one in everything() if one not in found]
    assert found == [one for one in everything() if one not in lost]
    assert 1 <= len(lost) <= 6
    assert [one[1] for one in lost] == list(range(lost[0][1], lost[-1][1] + 1))


def test_the_channels_of_a_lost_first_chunk_come_from_the_summary(tmp_path):
    path = write(tmp_path / "log.mcap", compression=CompressionType.NONE, chunk_size=600)
    flip_a_bit(path, 0)
    found, report = read(path)
    assert len(found) > MESSAGES - 7
    assert report.problem_count == 1


def test_messages_of_channels_that_are_lost_for_good_are_counted(tmp_path):
    path = write(
        tmp_path / "log.mcap",
        compression=CompressionType.NONE,
        chunk_size=600,
        repeat_channels=False,
        index_types=IndexType.NONE,
    )
    flip_a_bit(path, 0)
    found, report = read(path)
    assert found == []
    (chunk, *missing) = map(str, report.problems)
    assert "checksum" in chunk
    assert sorted(p.split(": ")[1] for p in missing) == [
        f"{n} messages of channel {k} lost" for k, n in ((1, 18), (2, 18))
    ]


@pytest.mark.parametrize("length", [2**60, 2**31, 2**28, 0, 45, None])
def test_a_wrong_chunk_length_or_a_hole_of_zeros_costs_one_chunk(tmp_path, length):
    path = write(tmp_path / "log.mcap", compression=CompressionType.ZSTD, chunk_size=600)
    content = bytearray(path.read_bytes())
    offset, own = chunks_of(content)[3]
    if length is None:
        content[offset : offset + 9 + own] = bytes(9 + own)
    else:
        struct.pack_into("<Q", content, offset + 1, length)
    path.write_bytes(content)
    found, report = read(path)
    assert MESSAGES - 6 <= len(found) < MESSAGES
    assert report.lost


def chunk(records, name=b"", packed=None, size=None, checksum=None):
    packed = records if packed is None else packed
    checksum = zlib.crc32(records) if checksum is None else checksum
    size = len(records) if size is None else size
    head = struct.pack("<QQQI", 1, 2, size, checksum) + text(name)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def message(channel, index):
    return record(5, struct.pack("<HIQQ", channel, index, 10**18 + index, 0) + payload(index))


FIRST = SCHEMA + CHANNEL + message(1, 0)
GOOD = SCHEMA + CHANNEL + message(1, 1)


def handmade(tmp_path, *records):
    path = tmp_path / "log.mcap"
    path.write_bytes(HEAD + b"".join(records))
    return path


BOMB = bytes(50_000_000)


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
        chunk(FIRST, b"zstd"),
        chunk(FIRST, b"lz4"),
        chunk(FIRST, b"zstd", zstandard.compress(BOMB)),
        chunk(FIRST, b"lz4", lz4.frame.compress(BOMB)),
        chunk(FIRST, b"zstd", zstandard.compress(FIRST)[:-4]),
        chunk(FIRST, b"lz4", lz4.frame.compress(FIRST)[:-20]),
    ],
)
def test_a_chunk_that_cannot_be_trusted_is_lost_whole_and_reading_goes_on(tmp_path, bad):
    found, report = read(handmade(tmp_path, bad, chunk(GOOD), record(15, bytes(4))))
    assert [one[1] for one in found] == [1]
    assert report.lost_chunks == report.problem_count == 1


@pytest.mark.parametrize(
    "packed",
    [zstandard.ZstdCompressor(write_content_size=False).compress(GOOD), zstandard.compress(GOOD)],
)
def test_zstd_chunks_are_read_with_and_without_their_size_in_the_frame(tmp_path, packed):
    found, report = read(handmade(tmp_path, chunk(GOOD, b"zstd", packed), record(15, bytes(4))))
    assert len(found) == 1
    assert not report.lost


def test_records_of_opcodes_to_come_and_private_ones_are_passed_over(tmp_path):
    strange = record(0x10, b"later"), record(0x90, b"private" * 1000)
    found, report = read(
        handmade(
            tmp_path, strange[0], SCHEMA, CHANNEL, strange[1], message(1, 1), record(15, bytes(4))
        )
    )
    assert len(found) == 1
    assert not report.lost


def test_messages_of_a_channel_whose_schema_is_missing_are_lost_and_counted(tmp_path):
    other = record(4, struct.pack("<HH", 2, 0) + text(b"/b") + text(b"json") + text(b""))
    records = CHANNEL, other, message(1, 1), message(2, 2), message(1, 3), record(15, bytes(4))
    found, report = read(handmade(tmp_path, *records))
    assert [one[1] for one in found] == [2]
    (problem,) = report.problems
    assert "2 messages of channel 1 lost" in str(problem)


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}])
def test_what_follows_the_end_mark_is_not_read_and_is_told(tmp_path, options, summary):
    path = write(tmp_path / "log.mcap", **options, **({} if summary else BARE))
    length = path.stat().st_size
    path.write_bytes(path.read_bytes() * 2)
    found, report = read(path)
    assert found == everything()
    (problem,) = report.problems
    assert problem.offset == length
    assert f"{length} bytes lost: they lie behind the end mark" in str(problem)


@pytest.mark.parametrize("kind", ["chunk", "message index", "footer"])
def test_records_that_have_no_place_in_a_chunk_are_passed_over(tmp_path, kind):
    inner = {"chunk": chunk(message(1, 2)), "message index": record(7, bytes(6)), "footer": b""}
    misplaced = inner[kind] or record(2, bytes(20))
    path = handmade(tmp_path, chunk(FIRST + misplaced + message(1, 3)), record(15, bytes(4)))
    found, _ = read(path)
    assert [one[1] for one in found] == [0, 3]


def test_metadata_and_small_attachments_come_and_large_ones_do_not(tmp_path):
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("wayside", {"spacing_m": "8.0"})
        writer.add_attachment(0, 0, "camera.yaml", "text/yaml", b"image_width: 3")
        writer.add_attachment(0, 0, "map.bin", "", bytes(2_000_000))
        writer.finish()
    report = ScanReport()
    found = list(scan(path, report))
    assert [type(one) for one in found] == [Metadata, Attachment]
    assert found[0].metadata == {"spacing_m": "8.0"}
    assert found[1].data == b"image_width: 3"
    assert not report.lost


@pytest.mark.parametrize("size", [2**64 - 1, 2**63, 2**40, 5])
def test_an_attachment_whose_size_is_wrong_is_lost_and_told(tmp_path, size):
    body = struct.pack("<QQ", 1, 1) + text(b"a.yaml") + text(b"") + struct.pack("<Q", size)
    bad = record(9, body + b"abc" + struct.pack("<I", 0))
    found, report = read(handmade(tmp_path, bad, chunk(GOOD), record(15, bytes(4))))
    assert len(found) == 1
    assert "attachment of" in str(report.problems[0])
    assert report.problem_count == 1


def test_a_hopeless_file_cannot_fill_the_memory_with_problems(tmp_path):
    bad = chunk(FIRST, checksum=1)
    _, report = read(handmade(tmp_path, *[bad] * 1000, record(15, bytes(4))))
    assert report.problem_count == 1000
    assert len(report.problems) == 201


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    places=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=8),
    chunked=st.booleans(),
)
def test_no_damage_makes_reading_fail_or_delivers_damaged_chunks(tmp_path, places, chunked):
    path = write(tmp_path / "log.mcap", use_chunking=chunked, chunk_size=600)
    content = bytearray(path.read_bytes())
    for share, value in places:
        content[8 + int(share * (len(content) - 9))] = value
    path.write_bytes(content)
    found, _ = read(path)
    if chunked:
        data = {one[2] for one in everything()}
        assert all(one[2] in data for one in found)
