"""Images that a log can hold and no run can use are reported before the run, each with its cause."""

import numpy as np
import pytest

from wayside.pipeline.logs.information import format_log, inspect_log
from wayside.schemas.errors import InputError
from wayside.stages.imaging import decode

from .conftest import HEIGHT, WIDTH, read


def raw_log(log, encoding, step, data):
    shape = {"width": WIDTH, "height": HEIGHT, "encoding": encoding, "step": step}
    return log.drive(3, image=None, raw=lambda index: shape | {"data": data(index)})


@pytest.mark.parametrize(
    ("encoding", "step", "size", "why"),
    [
        ("nv24", WIDTH, 3 * WIDTH * HEIGHT, "encoding 'nv24' is not supported"),
        ("bgr8", WIDTH, 3 * WIDTH * HEIGHT, "step is 32 bytes, a row of 32 pixels in bgr8"),
        ("mono8", WIDTH, (WIDTH + 4) * HEIGHT, "864 bytes are not 24 rows of 32 bytes"),
        ("mono8", WIDTH + 4, WIDTH * HEIGHT, "768 bytes are not 24 rows of 36 bytes"),
    ],
)
def test_images_that_cannot_be_decoded_are_refused_before_the_run_and_by_info(
    new_log, encoding, step, size, why
):
    path = raw_log(new_log(), encoding, step, lambda index: bytes([index]) * size)
    with pytest.raises(InputError, match="none of the images on /raw can be decoded") as error:
        read(path, spacing_m=8.0)
    assert why in str(error.value)
    text = format_log(inspect_log(path))
    assert why in text
    assert "can be used:" not in text


def test_compressed_images_of_no_known_format_are_refused_before_the_run(new_log):
    log = new_log().calibrated()
    log.add_image(0, data=b"no image", format="jxl")
    with pytest.raises(InputError, match="its format 'jxl' is not supported"):
        read(log.finish(), spacing_m=8.0)


def test_one_image_that_decodes_is_enough_to_begin(new_log):
    log = new_log().calibrated()
    log.add_image(0, data=b"\xff\xd8 no image")
    log.add_image(1)
    frames, _ = read(log.finish(), spacing_m=8.0)
    assert [f.status for f in frames][1] == "used"


@pytest.mark.parametrize(("brightest", "bits"), [(65535, 16), (4095, 12), (1000, 10), (200, 8)])
def test_samples_of_16_bits_are_taken_for_the_bits_that_the_drive_uses(new_log, brightest, bits):
    def samples(index):
        level = brightest if index == 1 else brightest // 100 * (index + 1)
        return np.full(WIDTH * HEIGHT, level, "<u2").tobytes()

    frames, report = read(raw_log(new_log(), "mono16", 2 * WIDTH, samples), spacing_m=8.0)
    (_, brightest_image, _) = decode(iter(frames))
    assert int(brightest_image.grey[0, 0]) == brightest >> (bits - 8)
    assert any(f"use {bits} of them" in note for note in report.notes) is (bits < 16)
