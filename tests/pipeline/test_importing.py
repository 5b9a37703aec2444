import os
import shutil
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader
from PIL import Image

from wayside.pipeline.logs.importing import ImportOptions, import_images
from wayside.schemas.errors import InputError, OutputError, UsageError

from .reading.conftest import read


def write_image(path, width=32, height=24):
    pixels = np.random.default_rng(list(path.name.encode())).integers(
        0, 256, (height, width, 3), np.uint8
    )
    assert cv2.imwrite(str(path), pixels)
    return path


def imported(files, calibration, out):
    """The frames of the log of these images, and what was said of them."""
    said = []
    import_images(files, calibration, out, ImportOptions(10.0), warn=said.append)
    return read(out)[0], said


def test_images_become_a_log_that_needs_no_spacing(tmp_path, calibration):
    folder = tmp_path / "images"
    folder.mkdir()
    files = [write_image(folder / f"P{n}.jpg") for n in (9, 10, 11, 100)]
    (folder / "notes.txt").write_text("no image")
    out = tmp_path / "drive.mcap"
    told = []
    how = ImportOptions(8.04672)
    done = import_images([folder], calibration, out, how, watch=lambda *of: told.append(of))
    assert done == (4, 0, 0, None)
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    frames, _ = read(out)
    assert [bytes(f.data) for f in frames] == [f.read_bytes() for f in files]
    assert [f.spacing_m for f in frames] == [None, 8.04672, 8.04672, 8.04672]
    assert {f.camera.fy for f in frames} == {51.0}
    assert frames[0].camera.distortion == (-0.2, 0.1, 0.0, 0.0, 0.5)
    assert all(f.header_time_ns is None for f in frames)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["camera.yaml", "drive.mcap", "images"]


def test_missing_numbers_are_missing_distances_and_are_said_by_import_and_by_a_run(
    tmp_path, calibration
):
    files = [write_image(tmp_path / f"P{n}.png") for n in (12, 14, 15, 18)]
    out = tmp_path / "drive.mcap"
    frames, said = imported(files, calibration, out)
    assert [f.spacing_m for f in frames] == [None, 20.0, 10.0, 30.0]
    _, report = read(out)
    given, _ = read(out, spacing_m=9.0)  # --spacing is the distance between images as they are
    assert [f.spacing_m for f in given] == [None, 9.0, 9.0, 9.0]
    for words in (*said, *report.notes):
        assert "missing numbers" in words
        assert "1 after P12.png, 2 after P15.png" in words
    assert (len(said), len(report.notes)) == (1, 1)
    uneven = [write_image(tmp_path / f"P{n}.jpg") for n in (110, 125, 131)]
    _, (words,) = imported(uneven, calibration, tmp_path / "uneven.mcap")
    assert words.startswith("the numbers in the names do not rise evenly")


def test_the_log_is_read_by_the_stock_reader_with_the_published_schemas(tmp_path, calibration):
    out = tmp_path / "drive.mcap"
    file = write_image(tmp_path / "1.jpg")
    import_images([file], calibration, out, ImportOptions(8.0))
    with out.open("rb") as stream:
        reader = make_reader(stream)
        messages = {s.name: m.data for s, _, m in reader.iter_messages()}
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    image = CompressedImage.FromString(messages["foxglove.CompressedImage"])
    assert (image.data, image.format) == (file.read_bytes(), "jpeg")
    camera = CameraCalibration.FromString(messages["foxglove.CameraCalibration"])
    assert (camera.width, camera.height, camera.distortion_model) == (32, 24, "plumb_bob")
    assert list(camera.K) == [50, 0, 16, 0, 51, 12, 0, 0, 1]
    assert list(camera.D) == [-0.2, 0.1, 0.0, 0.0, 0.5]
    assert list(camera.P) == [50, 0, 16, 0, 0, 51, 12, 0, 0, 0, 1, 0]
    assert metadata["wayside"]["spacing_m"] == "8.0"
    import_images([file], calibration, tmp_path / "again.mcap", ImportOptions(8.0))
    assert (tmp_path / "again.mcap").read_bytes() == out.read_bytes()


SIZES = r"wide\.jpg: the image has 40 x 24 .* is for 32 x 24"


@pytest.mark.parametrize(
    ("names", "spacing", "error", "words"),
    [
        (["1.jpg", "wide.jpg"], 8.0, InputError, SIZES),
        (["words.jpg"], 8.0, InputError, r"none of 1 files .* words\.jpg: no JPEG or PNG"),
        (["none.jpg"], 8.0, InputError, r"none\.jpg: no such file"),
        (["empty"], 8.0, UsageError, "no images to import"),
        *((["1.jpg"], spacing, UsageError, "--spacing") for spacing in (0.0, -1.0, float("nan"))),
    ],
)
def test_what_cannot_be_imported_is_refused_and_no_log_is_left(
    tmp_path, calibration, names, spacing, error, words
):
    write_image(tmp_path / "1.jpg")
    write_image(tmp_path / "wide.jpg", width=40)
    (tmp_path / "words.jpg").write_text("no image")
    (tmp_path / "empty").mkdir()
    files = [tmp_path / name for name in names]
    with pytest.raises(error, match=words):
        import_images(files, calibration, tmp_path / "drive.mcap", ImportOptions(spacing))
    assert not list(tmp_path.glob("drive*"))
    with pytest.raises(OutputError, match="the file cannot be written: No such file"):
        import_images(
            [tmp_path / "1.jpg"], calibration, tmp_path / "none" / "drive.mcap", ImportOptions(8.0)
        )


@pytest.mark.parametrize(
    ("tag", "written", "read"),
    [
        (0x9003, "2009:05:14 10:31:07", "2009-05-14 10:31:07"),
        (0x0132, "2009:05:14 10:31:07", "2009-05-14 10:31:07"),
        (0x9003, "    :  :     :  :  ", ""),
        (0x9003, None, ""),
    ],
)
def test_names_and_dates_of_cameras_travel_in_the_log(tmp_path, calibration, tag, written, read):
    exif = Image.Exif()
    if written:
        (exif if tag == 0x0132 else exif.get_ifd(0x8769))[tag] = written
    file = tmp_path / "US 36_0007.jpg"
    Image.open(write_image(tmp_path / "plain.png")).save(file, exif=exif)
    frames, said = imported([file], calibration, tmp_path / "drive.mcap")
    assert [(f.name, f.date) for f in frames] == [("US 36_0007.jpg", read)]
    assert said == []


@pytest.mark.parametrize(
    ("copies", "spacing"),
    [
        (["0003.jpg"], [None, 10.0, None, 10.0, 10.0]),
        (["0002 (1).jpg", "0002 (2).jpg"], [None, 10.0, None, None, 20.0, 10.0]),
    ],
)
def test_a_copy_is_said_adds_no_distance_and_leaves_the_numbers_of_the_others(
    tmp_path, calibration, copies, spacing
):
    originals = [f"{n:04d}.jpg" for n in (1, 2, 4, 5)]
    files = [write_image(tmp_path / name) for name in originals]
    files += [shutil.copy(tmp_path / "0002.jpg", tmp_path / name) for name in copies]
    frames, said = imported(map(Path, files), calibration, tmp_path / "drive.mcap")
    assert [f.name for f in frames if f.status == "used"] == originals
    assert [f.name for f in frames if f.status == "duplicate"] == copies
    assert [f.spacing_m for f in frames] == spacing
    assert f"{copies[0]} of 0002.jpg" in said[0]
    assert ["missing numbers" in words for words in said[1:]] == [True] * (len(copies) - 1)


def test_what_cannot_be_imported_is_left_out_and_named(tmp_path, calibration, command):
    folder = tmp_path / "images"
    folder.mkdir()
    for n in (1, 2, 9):
        write_image(folder / f"P{n}.jpg")
    (folder / "P3.jpg").symlink_to(tmp_path / "none.jpg")
    (folder / "P4.jpg").write_bytes(b"")
    (folder / "P5.jpg").mkdir()
    os.mkfifo(folder / "P6.jpg")
    (folder / "P7.jpg").write_text("no image")
    (folder / "P8.jpg").symlink_to(folder / "P8.jpg")
    latin = os.fsdecode(bytes(folder) + b"/P\xe9.jpg")
    os.rename(write_image(folder / "P10.jpg"), latin)
    out = tmp_path / "drive.mcap"
    line = ["--calibration", calibration, "--spacing", "8m", "-o", out]
    done = command("import", folder, *line)
    assert done.returncode == 4
    assert [f.name for f in read(out)[0]] == ["P1.jpg", "P2.jpg", "P9.jpg"]
    for words in (
        "left out: 7 of 10 files",
        "P3.jpg: a broken link",
        "P4.jpg: empty",
        "P5.jpg: Is a directory",
        "P6.jpg: a pipe",
        "P7.jpg: no JPEG or PNG image",
        "P8.jpg: a broken link",
        "and 1 more",
    ):
        assert words in done.stderr
    refused = command("import", latin, *line)
    assert refused.returncode == 3
    assert "P\\udce9.jpg: its name is not UTF-8" in refused.stderr
    assert command("import", folder / "P3.jpg", *line).returncode == 3


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_files_and_folders_that_may_not_be_read_are_named(tmp_path, calibration):
    images = [write_image(tmp_path / f"{n}.jpg") for n in (1, 2)]
    images[1].chmod(0)
    said = []
    import_images(
        images, calibration, tmp_path / "drive.mcap", ImportOptions(8.0), warn=said.append
    )
    assert "2.jpg: Permission denied" in said[0]
    folder = tmp_path / "closed"
    folder.mkdir(mode=0)
    with pytest.raises(InputError, match="closed: the folder cannot be listed"):
        import_images([folder], calibration, tmp_path / "other.mcap", ImportOptions(8.0))


def exif_of(second, place=None):
    """Exif data with the local time of capture, and latitude and longitude in degrees, minutes, seconds."""
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9003] = f"2024:05:17 10:31:{second:02d}"
    if place is not None:
        north, east = ((int(a), int(a % 1 * 60), a * 60 % 1 * 60) for a in map(abs, place))
        signs = {1: "N" if place[0] > 0 else "S", 3: "E" if place[1] > 0 else "W"}
        exif.get_ifd(0x8825).update(signs | {2: north, 4: east, 5: b"\1", 6: 12.5})
    return exif


PLACES = [(-33.5 + n * 1e-4, 150.25 + n * 1e-4) for n in range(4)]
GPX = '<gpx xmlns="http://www.topografix.com/GPX/1/0"><trk><trkseg>{}</trkseg></trk></gpx>'
POINT = '<trkpt lat="{}" lon="{}"><ele>-12.5</ele><time>2024-05-17T00:31:{:02d}Z</time></trkpt>'
SOURCES = {
    "exif": "",
    "files.csv": "file;lat;lon;alt\n"
    + "".join(f"a/{n}.jpg;{lat:.6f};{lon:.6f};-12,5\n" for n, (lat, lon) in enumerate(PLACES)),
    "times.csv": "time,lon,lat,alt\n"
    + "".join(
        f"2024-05-17T10:31:{2 * n:02d},{lon},{lat},-12.5\n" for n, (lat, lon) in enumerate(PLACES)
    ),
    "track.gpx": GPX.format("".join(POINT.format(*PLACES[n], 2 * n) for n in (0, 1, 3))),
}


@pytest.mark.parametrize("source", SOURCES)
def test_images_with_positions_need_no_spacing_and_have_a_date(tmp_path, calibration, source):
    """The track is of another time zone, and lacks the third image."""
    files = []
    for n, place in enumerate(PLACES):
        files.append(tmp_path / f"{n}.jpg")
        exif = exif_of(2 * n, place if source == "exif" else None)
        Image.open(write_image(tmp_path / f"{n}.png")).save(files[-1], exif=exif)
    file = tmp_path / source
    if SOURCES[source]:
        file.write_text(SOURCES[source])
    out, positions = tmp_path / "drive.mcap", file if SOURCES[source] else None
    done = import_images(files, calibration, out, ImportOptions(positions=positions))
    assert done[2:] == (4, datetime(2024, 5, 17, 10, 31))
    frames, _ = read(out, thin_m=0.0)
    places = [(f.fix.latitude_deg, f.fix.longitude_deg, f.fix.altitude_m) for f in frames]
    np.testing.assert_allclose(places, [(*p, -12.5) for p in PLACES], atol=1e-6)
    assert frames[0].time_ns == 1715941860 * 10**9
    assert [f.spacing_m for f in frames] == [None] * 4


def test_local_times_that_fit_a_track_in_several_zones_are_refused(tmp_path, calibration):
    file, track = tmp_path / "1.jpg", tmp_path / "long.gpx"
    Image.open(write_image(tmp_path / "1.png")).save(file, exif=exif_of(0))
    later = POINT.replace("T00:31", "T01:31")
    track.write_text(GPX.format(POINT.format(50, 7, 0) + later.format(51, 7, 0)))
    with pytest.raises(InputError, match="5 time zones fit the times of the images"):
        import_images([file], calibration, tmp_path / "o", ImportOptions(8.0, positions=track))


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.gpx", "<gpx>", "cannot be read"),
        ("a.csv", "file,lon\n1.jpg,7\n", "cannot be read: 'lat'"),
        ("a.csv", "file,lon,lat\n9.jpg,7,50\n", "match none of these 1 images"),
        ("a.csv", "file,route,milepost\n1.jpg,K-7,12.5\n", "--routes FILE"),
        ("a.gpx", GPX.format(POINT.format(50, 7, 1)), "need the time of each image"),
    ],
)
def test_positions_that_cannot_be_used_are_refused(tmp_path, calibration, name, text, words):
    file = tmp_path / name
    file.write_text(text)
    images, how = [write_image(tmp_path / "1.jpg")], ImportOptions(8.0, positions=file)
    with pytest.raises((InputError, UsageError), match=words):
        import_images(images, calibration, tmp_path / "drive.mcap", how)
