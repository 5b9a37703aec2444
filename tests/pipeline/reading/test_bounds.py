"""What a log may cost to read is bounded by its size, whatever it unpacks to."""

import resource
import struct
import time
import zlib

import lz4.frame
import pytest
import zstandard

from wayside.pipeline.files.parsing import parse_yaml
from wayside.pipeline.reading import survey
from wayside.pipeline.reading.bounds import Allowance
from wayside.pipeline.reading.records import Message, scan
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.reading.survey import survey_log
from wayside.schemas.errors import InputError

from .conftest import CHANNEL, HEAD, SCHEMA, record, text


def chunk(records, name=b"zstd"):
    packed = {b"zstd": zstandard.compress, b"lz4": lz4.frame.compress, b"": bytes}[name](records)
    head = struct.pack("<QQQI", 1, 2, len(records), zlib.crc32(records)) + text(name)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def message(data=b"{}"):
    return record(5, struct.pack("<HIQQ", 1, 1, 10**18, 0) + data)


DEFINITIONS = SCHEMA + CHANNEL
GOOD = chunk(DEFINITIONS + message())


def read(path, *records, allowance=None):
    path.write_bytes(HEAD + b"".join(records) + record(15, bytes(4)))
    report = ScanReport()
    return sum(isinstance(r, Message) for r in scan(path, report, allowance)), report


BOMBS = {
    "zeros": chunk(bytes(20_000_000)),
    "empty records": chunk(record(0x10, b"") * 600_000),
    "empty schemas": chunk(record(3, b"") * 600_000),
    "short messages": chunk(DEFINITIONS + message(b"") * 600_000),
    "lz4": chunk(bytes(120_000_000), b"lz4"),
    "zstd": chunk(bytes(150_000_000)),
}


@pytest.mark.parametrize("name", sorted(BOMBS))
def test_a_chunk_that_unpacks_beyond_measure_is_lost_at_once_and_reading_goes_on(tmp_path, name):
    started, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    messages, report = read(tmp_path / "log.mcap", BOMBS[name], GOOD)
    assert messages == 1
    assert report.lost_chunks == report.problem_count == 1
    assert time.process_time() - started < 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 260_000  # kB


def test_many_chunks_that_are_right_one_by_one_are_bounded_together(tmp_path):
    one = chunk(DEFINITIONS + message(bytes(10_000_000)))
    messages, report = read(tmp_path / "log.mcap", *[one] * 60)
    assert 0 < messages < 60
    assert report.lost_chunks == 60 - messages
    assert "more than 255 times what was read of the log" in str(report.problems[0])
    messages, report = read(tmp_path / "log.mcap", *[one] * 60, allowance=Allowance(ratio=10**6))
    assert messages == 60
    assert not report.lost


def test_nested_heads_of_chunks_do_not_cost_the_square_of_the_size(tmp_path):
    def heads(count):
        size, content = 60 * count, b""
        for k in range(count):
            left = size - 60 * (k + 1) + 60 - 9
            head = (
                struct.pack("<QQQI", 1, 2, left - 40, 1) + text(b"") + struct.pack("<Q", left - 40)
            )
            content += (struct.pack("<BQ", 6, left) + head).ljust(60, b"\x00")
        return content

    def cost(count):
        started = time.process_time()
        read(tmp_path / "log.mcap", heads(count))
        return time.process_time() - started

    assert cost(16_000) < 8 * cost(4000) + 0.5


@pytest.mark.parametrize("name", [b"", b"lz4"])
def test_what_lz4_can_reach_is_never_refused(tmp_path, name):
    one = chunk(DEFINITIONS + message(bytes(3_000_000)), name)
    messages, report = read(tmp_path / "log.mcap", *[one] * 30, allowance=Allowance(extra_bytes=0))
    assert messages == 30
    assert not report.lost


def test_attached_calibrations_are_read_up_to_a_size_in_all(new_log, monkeypatch):
    log = new_log()
    for number in range(40):
        text = f"camera_matrix: {'[' * 60 + ']' * 60}\nnumber: {number}\n"
        log.writer.add_attachment(0, 0, f"{number}.yaml", "", text.ljust(10_000).encode())
    log.add_image(0)
    tried = []
    monkeypatch.setattr(survey, "parse_camera", lambda text, name: tried.append(name) or refuse())
    survey_log(log.finish())
    assert tried == [f"{number}.yaml" for number in range(6)]


def refuse():
    raise InputError("made up")


@pytest.mark.parametrize("bracket", ["[", "{"])
def test_brackets_without_end_are_refused(bracket):
    with pytest.raises(ValueError, match="too deeply"):
        parse_yaml("camera_matrix: " + bracket * 60_000)
