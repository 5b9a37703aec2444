"""Real image bytes in, pixels out; bad ones are counted, never guessed."""

import io
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from wayside.schemas.frame import Camera, Frame
from wayside.stages.imaging.decoding import decode, used_bits

HEIGHT, WIDTH = 36, 52


def pixels(seed=0):
    """Smooth colours, so that neither JPEG nor chroma sampling moves them far."""
    small = np.random.default_rng(seed).integers(0, 256, (4, 5, 3)).astype(np.uint8)
    return cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)


def frame(data, encoding="jpeg", **changes):
    camera = Camera(WIDTH, HEIGHT, 50.0, 50.0, WIDTH / 2, HEIGHT / 2)
    return replace(Frame(0, 0, None, "used", encoding, data, camera, WIDTH, HEIGHT), **changes)


def jpeg(rgb, quality=95, subsampling=0, mode="RGB", **options):
    out = io.BytesIO()
    image = Image.fromarray(rgb).convert(mode)
    image.save(out, "JPEG", quality=quality, subsampling=subsampling, **options)
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
    png = cv2.imencode(".png", pixels()[..., ::-1])[1].tobytes()
    np.testing.assert_array_equal(decode_one(frame(png, "png")).rgb, pixels())


def textured(height=64, width=96):
    """Detail everywhere, so that every block has many codes."""
    return np.random.default_rng(1).integers(0, 256, (height, width, 3)).astype(np.uint8)


@pytest.mark.parametrize("subsampling", [0, 1, 2])
@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("rgb", [pixels(), textured(HEIGHT, WIDTH)], ids=["smooth", "textured"])
def test_the_pixels_of_a_jpeg_are_those_of_opencv(subsampling, progressive, rgb):
    data = jpeg(rgb, 75, subsampling, progressive=progressive)
    as_stored = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
    np.testing.assert_array_equal(decode_one(frame(data)).rgb, as_stored)


@pytest.mark.parametrize("mode", ["L", "CMYK"])
def test_grey_and_cmyk_jpegs_decode(mode):
    data = jpeg(pixels(), mode=mode)
    assert decode_one(frame(data)).frame.status == "used"
    assert decode_one(frame(data[:-50])).frame.status == "damaged"


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("share", [0.7, 0.9, 0.99])
@pytest.mark.parametrize("end", [b"", b"\xff\xd9", bytes(50), bytes(50) + b"\xff\xd9"])
def test_a_jpeg_of_which_a_part_is_missing_is_damaged(progressive, share, end):
    data = jpeg(textured(HEIGHT, WIDTH), progressive=progressive)
    image = decode_one(frame(data[: int(share * len(data))] + end))
    assert (image.frame.status, image.rgb, image.grey) == ("damaged", None, None)
    assert image.frame.data == b""


@pytest.mark.parametrize("encoding", ["tiff", "png", "jpeg"])
@pytest.mark.parametrize(("side", "status"), [(20032, "wrong_size"), (0, "undecodable")])
def test_an_image_larger_than_its_camera_is_not_decoded(encoding, side, status, monkeypatch):
    def decoded(*_, **__):
        raise AssertionError("it was decoded")

    monkeypatch.setattr(cv2, "imdecode", decoded)
    image = decode_one(frame(b"II*\0" + bytes(40), encoding, width=side, height=side))
    assert image.frame.status == status


def tiff(rgb, compression):
    options = [cv2.IMWRITE_TIFF_COMPRESSION, compression, cv2.IMWRITE_TIFF_ROWSPERSTRIP, 6]
    return cv2.imencode(".tiff", rgb[..., ::-1], options)[1].tobytes()


@pytest.mark.parametrize(
    ("compression", "wrong"), [(5, bytes(40)), (8, b"\xff" * 40)], ids=["LZW", "Deflate"]
)
def test_a_tiff_of_which_a_strip_does_not_decode_is_damaged(compression, wrong):
    whole = tiff(pixels(), compression)
    np.testing.assert_array_equal(decode_one(frame(whole, "tiff")).rgb, pixels())
    half = len(whole) // 2
    image = decode_one(frame(whole[:half] + wrong + whole[half + 40 :], "tiff"))
    assert (image.frame.status, image.rgb, image.grey) == ("damaged", None, None)


@pytest.mark.parametrize(
    ("encoding", "conversion"),
    [
        ("rgb8", None),
        ("bgr8", cv2.COLOR_RGB2BGR),
        ("8UC3", cv2.COLOR_RGB2BGR),
        ("rgba8", cv2.COLOR_RGB2RGBA),
        ("bgra8", cv2.COLOR_RGB2BGRA),
        ("8UC4", cv2.COLOR_RGB2BGRA),
        ("RGB8", None),
    ],
)
@pytest.mark.parametrize("padding", [0, 12])
def test_raw_rows_come_out_exactly_with_or_without_padding(encoding, conversion, padding):
    rgb = pixels()
    raw = rgb if conversion is None else cv2.cvtColor(rgb, conversion)
    rows = np.pad(raw.reshape(HEIGHT, -1), ((0, 0), (0, padding)))
    step = rows.shape[1] if padding else 0
    np.testing.assert_array_equal(decode_one(frame(rows.tobytes(), encoding, step=step)).rgb, rgb)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_mosaics_have_their_colours(pattern):
    color = {"r": 220, "g": 120, "b": 30}
    mosaic = np.empty((HEIGHT, WIDTH), np.uint8)
    for place, letter in enumerate(pattern):
        mosaic[place // 2 :: 2, place % 2 :: 2] = color[letter]
    rgb = decode_one(frame(mosaic.tobytes(), f"bayer_{pattern}8")).rgb
    np.testing.assert_array_equal(rgb[[8, 9], [8, 11]], [[220, 120, 30]] * 2)


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize(("encoding", "shift"), [("rgb16", 8), ("rgb16:12", 4), ("rgb16:8", 0)])
def test_samples_of_16_bits_keep_the_upper_eight_of_those_used(encoding, shift, padding):
    rows = (pixels().astype("<u2") << shift).reshape(HEIGHT, -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    one = frame(rows.tobytes(), encoding, step=rows.shape[1])
    np.testing.assert_array_equal(decode_one(one).rgb, pixels())
    assert used_bits(replace(one, encoding="rgb16")) == 8 + shift


@pytest.mark.parametrize(
    ("encoding", "order"),
    [
        ("uyvy", "uyvy"),
        ("yuv422", "uyvy"),
        ("yuyv", "yuyv"),
        ("yuv422_yuy2", "yuyv"),
        ("nv12", "uv"),  # brightness in a plane of its own
        ("NV21", "vu"),
    ],
)
def test_brightness_and_colour_at_half_the_width_make_the_colours(encoding, order):
    y, cr, cb = cv2.cvtColor(np.array([[[200, 60, 40]]], np.uint8), cv2.COLOR_RGB2YCrCb)[0, 0]
    narrow = [round(128 + (float(c) - 128) * 224 / 255) for c in (cb, cr)]  # video range
    value = {"y": round(16 + float(y) * 219 / 255), "u": narrow[0], "v": narrow[1]}
    planar = len(order) == 2
    data = bytes([value["y"]] * (HEIGHT * WIDTH if planar else 0))
    data += bytes(value[letter] for letter in order) * (HEIGHT * WIDTH // (4 if planar else 2))
    rgb = decode_one(frame(data, encoding)).rgb
    np.testing.assert_allclose(rgb.astype(int).mean(axis=(0, 1)), [200, 60, 40], atol=3)
    assert decode_one(frame(data[:-2], encoding)).frame.status == "undecodable"


@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "mono16"])
def test_grey_rows_come_out_in_all_three_channels(encoding):
    grey = pixels()[..., 1].copy()
    rows = grey.astype("<u2") * 257 if encoding == "mono16" else grey
    image = decode_one(frame(rows.tobytes(), encoding))
    np.testing.assert_array_equal(image.rgb, np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_array_equal(image.grey, grey)


def jpeg_with_thumbnail():
    data, thumbnail = jpeg(pixels()), jpeg(pixels()[:8, :8])
    return data[:2] + b"\xff\xe5" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail + data[2:]


def turned_exif():
    exif = Image.Exif()
    exif[0x0112] = 6
    return exif.tobytes()


@pytest.mark.parametrize(
    "data",
    [
        jpeg(pixels(), exif=turned_exif()),
        jpeg(pixels())[:-2] + bytes(4) + jpeg(pixels())[-2:],
        jpeg(pixels()) + bytes(64),
        jpeg_with_thumbnail(),
    ],
    ids=["orientation tag", "filling bytes before the end", "bytes behind the end", "thumbnail"],
)
def test_what_stands_beside_the_pixels_does_not_change_them(data):
    image, plain = decode_one(frame(data)), decode_one(frame(jpeg(pixels())))
    assert image.frame.status == "used"
    np.testing.assert_array_equal(image.rgb, plain.rgb)


def jpeg_of_endless_scans():
    data = jpeg(pixels(), progressive=True)
    return data[:-2] + data[data.rindex(b"\xff\xda") : -2] * 2000 + data[-2:]


def jpeg_of_wrong_codes():
    data = jpeg(textured(HEIGHT, WIDTH))
    middle = len(data) * 3 // 4
    noise = np.random.default_rng(0).integers(0, 255, 300).astype(np.uint8).tobytes()
    return data[:middle] + noise + data[middle + 300 :]


RAW, SMALL = pixels().tobytes(), jpeg(pixels()[:-2])
NO_IMAGE = b"", jpeg(pixels())[:30], b"not an image at all", jpeg_of_endless_scans()
NO_ROWS = (RAW[:-1], {}), (RAW + bytes(1), {}), (RAW, {"step": WIDTH * 3 - 1}), (RAW, {"width": 0})
STATES = [
    ("used", jpeg(pixels()), {}),
    ("damaged", jpeg_with_thumbnail()[:-40], {}),
    ("damaged", jpeg_of_wrong_codes(), {}),
    *(("undecodable", data, {}) for data in NO_IMAGE),
    ("undecodable", bytes(500), {"encoding": "32FC1"}),
    ("wrong_size", SMALL, {"height": HEIGHT - 2}),
    ("wrong_size", SMALL, {}),  # whatever its header was said to be
    *(("undecodable", data, {"encoding": "rgb8"} | more) for data, more in NO_ROWS),
]


def test_every_frame_comes_out_once_and_in_order_with_what_became_of_it():
    frames = [frame(data, **{"index": i, **more}) for i, (_, data, more) in enumerate(STATES)]
    unused = frame(b"", index=len(frames), status="thinned")
    found = list(decode(iter([*frames, unused])))
    assert [one.frame.status for one in found] == [*(state for state, *_ in STATES), "thinned"]
    assert [one.frame.index for one in found] == list(range(len(frames) + 1))
    assert all((one.rgb is None) == (one.frame.status != "used") for one in found)
    assert found[-1].frame is unused
