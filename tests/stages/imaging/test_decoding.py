"""Real image bytes in, pixels out; bad ones are counted, never guessed."""

import io
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from wayside.schemas.frame import Camera, Frame
from wayside.stages.imaging.decoding import decode

HEIGHT, WIDTH = 36, 52


def pixels(seed=0):
    """Smooth colours, so that neither JPEG nor chroma sampling moves them far."""
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 256, (4, 5, 3)).astype(np.uint8)
    return cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


def frame(data, encoding="jpeg", **changes):
    camera = Camera(WIDTH, HEIGHT, 50.0, 50.0, WIDTH / 2, HEIGHT / 2)
    base = Frame(0, 0, None, "used", encoding, data, camera, WIDTH, HEIGHT)
    return replace(base, **changes)


def jpeg(rgb, **options):
    out = io.BytesIO()
    Image.fromarray(rgb).save(out, "JPEG", quality=95, subsampling=0, **options)
    return out.getvalue()


def png(rgb):
    out = io.BytesIO()
    Image.fromarray(rgb).save(out, "PNG")
    return out.getvalue()


def decode_one(one):
    (image,) = decode(iter([one]))
    return image


def test_a_jpeg_comes_out_as_rgb_and_grey():
    image = decode_one(frame(jpeg(pixels())))
    assert image.frame.status == "used"
    assert image.rgb.flags.c_contiguous
    assert (image.rgb.dtype, image.grey.dtype) == (np.uint8, np.uint8)
    np.testing.assert_allclose(image.rgb.astype(int), pixels().astype(int), atol=8)
    luma = image.rgb @ np.array([0.299, 0.587, 0.114])
    np.testing.assert_allclose(image.grey, luma, atol=1)


def test_a_png_comes_out_exactly():
    np.testing.assert_array_equal(decode_one(frame(png(pixels()), "png")).rgb, pixels())


def test_bytes_given_as_a_memoryview_are_the_same():
    data = jpeg(pixels())
    np.testing.assert_array_equal(
        decode_one(frame(memoryview(data))).rgb, decode_one(frame(data)).rgb
    )


def test_the_orientation_tag_is_ignored():
    exif = Image.Exif()
    exif[0x0112] = 6
    turned = decode_one(frame(jpeg(pixels(), exif=exif.tobytes())))
    np.testing.assert_array_equal(turned.rgb, decode_one(frame(jpeg(pixels()))).rgb)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.97])
def test_a_jpeg_cut_short_is_undecodable(share):
    data = jpeg(pixels())
    image = decode_one(frame(data[: int(share * len(data))]))
    assert (image.frame.status, image.rgb, image.grey) == ("undecodable", None, None)


def test_a_jpeg_cut_after_its_thumbnail_is_undecodable():
    thumbnail = jpeg(pixels()[:8, :8])
    data = jpeg(pixels())
    marker = b"\xff\xe5" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    whole = data[:2] + marker + data[2:]
    assert decode_one(frame(whole)).frame.status == "used"
    assert decode_one(frame(whole[:-40])).frame.status == "undecodable"


def test_padding_after_a_jpeg_does_no_harm():
    assert decode_one(frame(jpeg(pixels()) + bytes(64))).frame.status == "used"


def test_bytes_that_are_no_image_are_undecodable():
    assert decode_one(frame(b"not an image at all")).frame.status == "undecodable"
    assert decode_one(frame(bytes(500), "32FC1")).frame.status == "undecodable"


def test_an_image_of_another_size_than_the_cameras_is_counted_as_such():
    image = decode_one(frame(jpeg(pixels()[:-2])))
    assert (image.frame.status, image.rgb) == ("wrong_size", None)


def test_frames_out_of_use_pass_untouched():
    unused = frame(b"", status="thinned")
    image = decode_one(unused)
    assert image.frame is unused
    assert image.rgb is None


def test_every_frame_comes_out_once_and_in_order():
    good, bad = frame(jpeg(pixels())), frame(b"bad")
    frames = [replace(good, index=0), replace(bad, index=1), replace(good, index=2)]
    statuses = [(p.frame.index, p.frame.status) for p in decode(iter(frames))]
    assert statuses == [(0, "used"), (1, "undecodable"), (2, "used")]


@pytest.mark.parametrize(
    ("encoding", "conversion"),
    [
        ("rgb8", None),
        ("bgr8", cv2.COLOR_RGB2BGR),
        ("8UC3", cv2.COLOR_RGB2BGR),
        ("rgba8", cv2.COLOR_RGB2RGBA),
        ("bgra8", cv2.COLOR_RGB2BGRA),
        ("8UC4", cv2.COLOR_RGB2BGRA),
    ],
)
@pytest.mark.parametrize("padding", [0, 12])
def test_raw_rows_come_out_exactly_with_or_without_padding(encoding, conversion, padding):
    rgb = pixels()
    raw = rgb if conversion is None else cv2.cvtColor(rgb, conversion)
    rows = np.pad(raw.reshape(HEIGHT, -1), ((0, 0), (0, padding)))
    step = rows.shape[1] if padding else 0
    np.testing.assert_array_equal(decode_one(frame(rows.tobytes(), encoding, step=step)).rgb, rgb)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_rows_come_out_in_all_three_channels(encoding):
    grey = pixels()[..., 1].copy()
    image = decode_one(frame(grey.tobytes(), encoding))
    np.testing.assert_array_equal(image.rgb, np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_array_equal(image.grey, grey)


@pytest.mark.parametrize(
    ("encoding", "luma"), [("uyvy", 1), ("yuv422", 1), ("yuyv", 0), ("yuv422_yuy2", 0)]
)
def test_packed_yuv_has_its_colours(encoding, luma):
    color = np.array([[[200, 60, 40]]], np.uint8)
    y, cr, cb = cv2.cvtColor(color, cv2.COLOR_RGB2YCrCb)[0, 0]
    y = np.uint8(16 + float(y) * 219 / 255)  # video range
    pair = [cb, y, cr, y] if luma == 1 else [y, cb, y, cr]
    data = np.tile(np.array(pair, np.uint8), HEIGHT * WIDTH // 2)
    rgb = decode_one(frame(data.tobytes(), encoding)).rgb
    np.testing.assert_allclose(rgb.astype(int).mean(axis=(0, 1)), color[0, 0], atol=12)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_mosaics_have_their_colours(pattern):
    color = {"r": 220, "g": 120, "b": 30}
    mosaic = np.empty((HEIGHT, WIDTH), np.uint8)
    for place, letter in enumerate(pattern):
        mosaic[place // 2 :: 2, place % 2 :: 2] = color[letter]
    rgb = decode_one(frame(mosaic.tobytes(), f"bayer_{pattern}8")).rgb
    np.testing.assert_array_equal(rgb[8, 8], [220, 120, 30])
    np.testing.assert_array_equal(rgb[9, 11], [220, 120, 30])


def test_raw_rows_too_few_or_too_short_are_undecodable():
    data = pixels().tobytes()
    assert decode_one(frame(data[:-1], "rgb8")).frame.status == "undecodable"
    assert decode_one(frame(data, "rgb8", step=WIDTH * 3 - 1)).frame.status == "undecodable"
    assert decode_one(frame(data, "rgb8", width=0)).frame.status == "undecodable"
