import io

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from wayside.pipeline.reading.image_headers import format_word, read_image_header


def encoded(suffix, height=37, width=53, **options):
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    if suffix in ("webp", "tiff") and options:
        out = io.BytesIO()
        Image.fromarray(pixels).save(out, suffix.upper(), **options)
        return out.getvalue()
    return cv2.imencode(f".{suffix}", pixels)[1].tobytes()


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tiff", "bmp", "avif"])
@pytest.mark.parametrize("size", [(37, 53), (64, 48), (700, 301)])
def test_size_and_format_are_those_that_the_decoder_finds(suffix, size):
    data = encoded(suffix, *size)
    assert cv2.imdecode(np.frombuffer(data, np.uint8), 1).shape[:2] == size
    header = read_image_header(memoryview(data))
    assert header == (format_word(suffix), size[1], size[0])


def test_a_progressive_jpeg_with_restart_marks_tells_its_size():
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2]
    data = cv2.imencode(".jpg", np.zeros((24, 32, 3), np.uint8), options)[1].tobytes()
    assert read_image_header(data) == ("jpeg", 32, 24)


@pytest.mark.parametrize("options", [{"lossless": True}, {"quality": 50}, {"exif": b"Exif\0\0"}])
def test_every_form_of_webp_tells_its_size(options):
    assert read_image_header(encoded("webp", **options))[1:] == (53, 37)


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tiff", "bmp", "avif"])
def test_a_header_that_is_cut_off_tells_nothing_or_the_size(suffix):
    data = encoded(suffix)
    for size in range(0, len(data), 1 + len(data) // 300):
        header = read_image_header(data[:size])
        assert header is None or header[1:] == (53, 37)


@given(
    st.sampled_from([b"", b"\xff\xd8", b"II*\0", b"MM\0*", b"BM", b"RIFF1234WEBPVP8 "]), st.binary()
)
def test_no_bytes_make_reading_a_header_fail(start, rest):
    header = read_image_header(start + rest)
    assert header is None or (header.width > 0 and header.height > 0)
