"""The order of imported images: by folder, date of capture and number."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from wayside.pipeline.logs.importing import ImportOptions, import_images
from wayside.schemas.errors import InputError

from .conftest import with_exif
from .reading.conftest import read


@pytest.fixture
def take(tmp_path):
    """Take an image: `take("100MEDIA/DSC_0001.JPG", 3.5)`, so many seconds after 15:00:00; None: without a date."""

    def take(name, second=None, *, exact=True, **exif):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        pixels = np.random.default_rng(list(name.encode())).integers(0, 256, (24, 32, 3), np.uint8)
        data = cv2.imencode(".jpg", pixels)[1].tobytes()
        if second is not None:
            exif = {"taken": f"2024:06:10 15:{int(second) // 60:02d}:{int(second) % 60:02d}"} | exif
            if exact:
                exif["fraction"] = f"{round(second % 1 * 1000):03d}"
        path.write_bytes(with_exif(data, **exif) if exif else data)
        return path

    return take


@pytest.fixture
def imported(tmp_path, calibration):
    """Names and distances of the images of a log made of these, and what was said."""

    def imported(paths, order=""):
        said = []
        out = tmp_path / "drive.mcap"
        how = ImportOptions(10.0, order=order, overwrite=True)
        import_images(paths, calibration, out, how, warn=said.append)
        frames, _ = read(out)
        return [f.name for f in frames], [f.spacing_m for f in frames], said

    return imported


def last(folders):
    """The folder of images that are taken one after the other."""
    return list(folders)[-1]


def names(prefix, numbers, width=4):
    return [f"{prefix}{number:0{width}d}.JPG" for number in numbers]


WRAPPED = [*range(9995, 10000), *range(1, 7)]


@pytest.mark.parametrize("prefix", ["DSC_", "DSC0", "", "frame_"])
@pytest.mark.parametrize("exact", [True, False])
def test_a_counter_that_starts_again_is_followed_by_the_dates(take, imported, prefix, exact):
    wanted = names(prefix, WRAPPED)
    for k, name in enumerate(wanted):
        take(f"in/{name}", k / 3, exact=exact)
    found, spacing, said = imported([take(f"in/{wanted[0]}", 0.0, exact=exact).parent])
    assert found == wanted
    assert spacing == [None, *[10.0] * 10]
    assert said == [f"numbers start again or go back: {prefix}0001.JPG behind {prefix}9999.JPG"]


UNEVEN = "the numbers in the names do not rise evenly"
AGAIN, MISSING = "numbers start again or go back", "missing numbers"
GROUPS = [f"G00{group}000{k}.JPG" for group in (1, 2) for k in (1, 2, 4)]
GAPS = names("DSC_", [9996, 9998, 2, 3])  # without 9997, 9999 and 1
ORDERS = {
    "it starts again": (names("DSC_", WRAPPED), [None] * 11, [10.0] * 10, [AGAIN]),
    "with numbers missing": (GAPS, range(4), [20.0, 30.0, 10.0], [AGAIN, MISSING]),
    "it did not": (names("DSC_", [1, 2, 3, 9998, 9999]), range(5), [10.0] * 4, [UNEVEN]),
    "within a second": (names("I_", range(10)), [k // 4 for k in range(10)], [10.0] * 9, []),
    "the same date": (names("I_", range(1, 5)), [7] * 4, [10.0] * 3, []),
    "every second": (["a2.jpg", "a4.jpg", "a10.jpg"], [None] * 3, [10.0, 30.0], [MISSING]),
    "no step": (["a10.jpg", "a25.jpg", "a31.jpg"], [None] * 3, [10.0] * 2, [UNEVEN]),
    "a leap": (["a1.jpg", "a2.jpg", "a900.jpg"], [None] * 3, [10.0] * 2, [UNEVEN]),
    "two names": (["a1.jpg", "b1.jpg"], [None] * 2, [10.0], [UNEVEN]),
    "no numbers": (["first.jpg", "second.jpg"], [None] * 2, [10.0], [UNEVEN]),
    "groups": (GROUPS, range(6), [10.0, 20.0, 10.0, 10.0, 20.0], [MISSING]),
}
"""Names in their order, seconds of capture, distances, and the beginnings of what is said."""


@pytest.mark.parametrize("order", ORDERS)
def test_images_are_in_the_order_of_their_numbers(take, imported, order):
    wanted, seconds, steps, words = ORDERS[order]
    paths = [take(f"in/{n}", s, exact=False) for n, s in zip(wanted, seconds, strict=True)]
    found, spacing, said = imported(paths[::-1])
    assert (found, spacing) == (wanted, [None, *steps])
    assert [line.split(":")[0] for line in said] == words


@pytest.mark.parametrize(
    ("numbers", "seconds"),
    [
        ([1, 2, 3, 4, 5, 6], [10, 11, 12, 0, 1, 2]),  # the clock was set back
        ([1, 2, 3, 4, 5, 6], [0, 2, 1, 3, 4, 5]),
        ([1, 2, 3, 4, 5, 6], [5, 4, 3, 2, 1, 0]),
        ([9998, 9999, 1, 2, 3, 4], [0, 1, 2, 4, 3, 5]),
        ([1, 2, 3, 4, 5, 6], [0.0, 0.4, 0.2, 0.6, 0.8, 1.0]),
    ],
)
def test_dates_that_contradict_the_numbers_are_refused_with_both_orders(
    take, imported, numbers, seconds
):
    paths = [take(f"in/{n}", s) for n, s in zip(names("I_", numbers), seconds, strict=True)]
    by_date = [p.name for p in sorted(paths, key=lambda p: seconds[paths.index(p)])]
    with pytest.raises(InputError, match="contradict the order of folders and names") as refused:
        imported(paths)
    first, by_name, dated = str(refused.value).splitlines()
    assert "--order name or --order date" in first
    assert by_name.startswith("  by name: ")
    assert dated.startswith("  by date: ")
    assert imported(paths, "date")[0] == by_date
    assert imported(paths, "name")[0] == sorted(p.name for p in paths)


def test_two_cameras_in_one_folder_are_refused(take, imported):
    for k in range(5):
        take(f"in/DSC_{k:04d}.JPG", k + 0.5)
        path = take(f"in/IMG_{k:04d}.JPG", k)
    with pytest.raises(InputError, match="leave out images of another camera"):
        imported([path.parent])


def test_dates_of_change_say_nothing(take, imported):
    wanted = names("I_", range(1, 5))
    for k, name in enumerate(wanted):
        path = take(f"in/{name}", changed=f"2024:06:11 10:00:{50 - k}")
    assert imported([path.parent])[0] == wanted


def test_offsets_of_time_zones_count_where_all_dates_have_one(take, imported):
    wanted = names("I_", range(1, 5))  # a border is passed after the second image
    for offset in (("+02:00", "+01:00"), ("", "")):
        for k, name in enumerate(wanted):
            local = f"2024:06:10 {15 - (k > 1)}:00:0{k}"
            folder = take(f"in/{name}", 0, taken=local, offset=offset[k > 1]).parent
        if any(offset):
            assert imported([folder])[0] == wanted
    with pytest.raises(InputError, match="dates of capture"):
        imported([folder])


@pytest.mark.parametrize("dated", [True, False])
@pytest.mark.parametrize("turned", [True, False])
def test_folders_of_a_camera_are_in_the_order_of_their_numbers(take, imported, dated, turned):
    folders = []
    for folder, first in (("99MEDIA", 0), ("100MEDIA", 3), ("101MEDIA", 6)):
        for k in range(3):
            path = take(f"{folder}/DSC0000{k + 1}.JPG", first + k if dated else None)
        folders.append(path.parent)
    found, spacing, said = imported(folders[::-1] if turned else folders)
    assert found == ["DSC00001.JPG", "DSC00002.JPG", "DSC00003.JPG"] * 3
    assert spacing == [None, *[10.0] * 8]
    assert len(said) == 1
    assert "folders are taken in this order" in said[0]
    assert said[0].index("/99MEDIA") < said[0].index("/100MEDIA") < said[0].index("/101MEDIA")


def test_a_number_goes_on_in_the_next_folder(take, imported):
    for k, number in enumerate((9997, 9999)):
        first = take(f"100CANON/IMG_{number}.JPG", k).parent
    for k, number in enumerate((1, 3)):
        second = take(f"101CANON/IMG_{number:04d}.JPG", 5 + k).parent
    found, spacing, _ = imported([second, first])
    assert found == ["IMG_9997.JPG", "IMG_9999.JPG", "IMG_0001.JPG", "IMG_0003.JPG"]
    assert spacing == [None, 20.0, 10.0, 20.0]


def test_folders_taken_at_the_same_time_are_refused(take, imported):
    front = last(take(f"front/I_{k:04d}.JPG", k).parent for k in range(3))
    rear = last(take(f"rear/I_{k:04d}.JPG", k + 0.5).parent for k in range(3))
    with pytest.raises(InputError, match="front/I_0000"):
        imported([front, rear])


def test_folders_of_any_names_are_in_the_order_of_their_dates(take, imported):
    later = last(take(f"a/{k}.jpg", 10 + k).parent for k in range(1, 3))
    earlier = last(take(f"b/{k + 5}.jpg", k).parent for k in range(1, 3))
    assert imported([later, earlier])[0] == ["6.jpg", "7.jpg", "1.jpg", "2.jpg"]


def test_dates_of_copies_are_no_witness(take, imported):
    paths = [take(f"in/{k}.jpg", k) for k in (1, 2, 3)]
    paths.append(Path(shutil.copy(paths[0], paths[0].with_name("4.jpg"))))
    found, spacing, _ = imported(paths)
    assert found == ["1.jpg", "2.jpg", "3.jpg", "4.jpg"]
    assert spacing == [None, 10.0, 10.0, None]


def test_a_copy_does_not_hide_that_a_counter_starts_again(take, imported):
    paths = [take(f"in/{name}", k) for k, name in enumerate(names("DSC_", WRAPPED))]
    for place in (1, 7):
        paths.append(Path(shutil.copy(paths[place], f"{paths[place].with_suffix('')} (1).JPG")))
    found, spacing, _ = imported(paths)
    assert [name for name in found if "(1)" not in name] == names("DSC_", WRAPPED)
    assert [step for step in spacing if step] == [10.0] * 10


def test_an_order_by_date_needs_all_dates(take, imported):
    paths = [take("in/1.jpg", 1), take("in/2.jpg")]
    with pytest.raises(InputError, match=r"1 of 2 images have no date .* in/2\.jpg"):
        imported(paths, "date")


def test_the_command_forces_an_order(take, command, tmp_path, calibration):
    folder = last(take(f"in/{k}.jpg", 10 - k).parent for k in (1, 2))
    line = ["import", folder, "--calibration", calibration, "--spacing", "8m", "-o"]
    out = tmp_path / "drive.mcap"
    assert command(*line, out).returncode == 3
    assert not out.exists()
    assert command(*line, out, "--order", "date").returncode == 0
    assert command(*line, out, "--order", "size").returncode == 2


@pytest.mark.parametrize("tag", range(10))
def test_an_image_that_is_to_be_shown_otherwise_than_it_is_stored_is_refused(
    take, imported, tmp_path, tag
):
    jpeg, png = take("in/1.jpg", 1, orientation=tag), tmp_path / "1.png"
    exif = Image.Exif()
    exif[0x0112] = tag
    Image.new("RGB", (32, 24)).save(png, exif=exif)
    for path in (jpeg, png):
        if tag in range(2, 9):
            with pytest.raises(InputError, match=rf"{path.name}: its Exif orientation .*exiftran"):
                imported([path])
        else:
            assert imported([path])[0] == [path.name]
