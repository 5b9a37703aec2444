import io

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from wayside.pipeline.reading.image_headers import read_image_header

FORMS = [(name, {}) for name in ("jpeg", "png", "webp", "tiff", "bmp", "avif")]
FORMS += [("jpeg", {"progressive": True, "restart_marker_blocks": 2})]
FORMS += [("webp", more) for more in ({"lossless": True}, {"quality": 50}, {"exif": b"Exif\0\0"})]


def encoded(name, options, height=37, width=53):
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, name, **options)
    return out.getvalue()


@pytest.mark.parametrize(("name", "options"), FORMS)
@pytest.mark.parametrize("size", [(37, 53), (64, 48), (700, 301)])
def test_size_and_format_are_those_that_the_decoder_finds(name, options, size):
    data = encoded(name, options, *size)
    assert cv2.imdecode(np.frombuffer(data, np.uint8), 1).shape[:2] == size
    assert read_image_header(memoryview(data)) == (name, size[1], size[0])


@pytest.mark.parametrize(("name", "options"), FORMS[:6])
def test_a_header_that_is_cut_off_tells_nothing_or_the_size(name, options):
    data = encoded(name, options)
    for size in range(0, len(data), 1 + len(data) // 300):
        header = read_image_header(data[:size])
        assert header is None or header[1:] == (53, 37)


@given(
    st.sampled_from([b"", b"\xff\xd8", b"II*\0", b"MM\0*", b"BM", b"RIFF1234WEBPVP8 "]), st.binary()
)
def test_no_bytes_make_reading_a_header_fail(start, rest):
    header = read_image_header(start + rest)
    assert header is None or (header.width > 0 and header.height > 0)
