"""Parts of drives and ROS bags, written by the stock writers, joined to one log."""

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores

from wayside.pipeline.logs.joining import join_logs, readable_log
from wayside.pipeline.reading.layout import Budget
from wayside.pipeline.reading.parts import log_parts
from wayside.pipeline.reading.records import Message, ScanReport, messages_at, scan
from wayside.pipeline.results.result import log_fingerprint
from wayside.schemas.errors import InputError

from .reading.conftest import START, STEP, Ros2, image, read


def _write(writer, dialect, serialized, indices):
    """Images with one calibration, and messages of a type that is not understood."""
    with writer:
        known = {}
        for index in indices:
            time = START + index * STEP
            picture = {"format": "jpeg", "data": image(index)}
            for topic, name, content in (
                ("/camera/camera_info", *_made(dialect, "calibration", time, {})),
                ("/camera/image", *_made(dialect, "image", time, picture)),
                ("/words", "std_msgs/msg/String", {"data": "nothing for wayside"}),
            ):
                if topic not in known:
                    known[topic] = writer.add_connection(topic, name, typestore=dialect.store)
                writer.write(known[topic], time, serialized(dialect.message(name, content), name))
    return writer.path


def _made(dialect, kind, time, content):
    return dialect.names[kind], dialect.make(kind, time, content)


def write_ros2(folder, indices, plugin):
    """A bag directory."""
    dialect, writer = Ros2(), Ros2Writer(folder, version=9, storage_plugin=plugin)
    return _write(writer, dialect, dialect.store.serialize_cdr, indices)


def write_ros1(path, indices):
    dialect = Ros2(Stores.ROS1_NOETIC)
    return _write(Ros1Writer(path), dialect, dialect.store.serialize_ros1, indices)


def assert_images(log, indices):
    frames, _ = read(log, spacing_m=8.0)
    assert [bytes(f.data) for f in frames] == [image(i) for i in indices]
    assert [f.header_time_ns for f in frames] == [START + i * STEP for i in indices]
    assert {f.camera.fy for f in frames} == {41.0}
    assert {f.status for f in frames} == {"used"}


@pytest.mark.parametrize("kind", [StoragePlugin.MCAP, StoragePlugin.SQLITE3, "ros1"])
def test_bags_become_a_log(tmp_path, kind):
    if kind == "ros1":
        bags = [write_ros1(tmp_path / f"{i}.bag", range(2 * i, 2 * i + 2)) for i in range(3)]
    else:
        bags = [write_ros2(tmp_path / "bag", range(6), kind)]
    before = {*tmp_path.iterdir()}
    joined = join_logs(bags, tmp_path / "drive.mcap")
    assert len(joined.parts) == len(bags)
    assert joined.topics == (3 if kind is StoragePlugin.MCAP else 2)
    assert_images(tmp_path / "drive.mcap", range(6))
    assert {*tmp_path.iterdir()} == before | {tmp_path / "drive.mcap"}


def write_split(folder, first_indices, second_indices):
    first = write_ros2(folder / "bag", first_indices, StoragePlugin.MCAP)
    second = write_ros2(folder / "other", second_indices, StoragePlugin.MCAP)
    (part,) = second.glob("*.mcap")
    part.rename(first / "bag_1.mcap")
    listing = first / "metadata.yaml"
    (name,) = (p.name for p in first.glob("*.mcap") if p.name != "bag_1.mcap")
    content = yaml.safe_load(listing.read_text())
    content["rosbag2_bagfile_information"]["relative_file_paths"] = [name, "bag_1.mcap"]
    listing.write_text(yaml.safe_dump(content))
    return first


def test_a_split_bag_is_read_in_the_order_of_its_parts(tmp_path):
    first = write_split(tmp_path, range(3), range(3, 5))
    assert_images(first, range(5))
    report = ScanReport()
    found = [m for m in scan(first, report) if isinstance(m, Message)]
    offsets = [m.offset for m in found]
    assert offsets == sorted(offsets)
    channels = [m.channel for m in found]
    again = messages_at(log_parts(first), offsets[-1], channels, Budget.of(10**6))
    assert (again[-1].sequence, again[-1].offset) == (found[-1].sequence, offsets[-1])
    assert (report.messages, report.messages_stated, report.problem_count) == (15, 15, 0)
    size = sum(p.stat().st_size for p in first.glob("*.mcap"))
    assert report.bytes_read == report.bytes_total == size
    assert len(join_logs([first], tmp_path / "drive.mcap").parts) == 2
    assert_images(tmp_path / "drive.mcap", range(5))
    (first / "bag_1.mcap").unlink()
    with pytest.raises(InputError, match=r"there is no bag_1\.mcap"):
        join_logs([first], tmp_path / "again.mcap")


def test_parts_whose_times_interleave_are_read_in_the_order_of_time(tmp_path):
    assert_images(write_split(tmp_path, (0, 2, 4), (1, 3)), range(5))


def test_damage_in_a_part_names_its_file_and_the_other_parts_are_used(tmp_path):
    bag = write_split(tmp_path, range(3), range(3, 5))
    part = bag / "bag_1.mcap"
    part.write_bytes(part.read_bytes()[: part.stat().st_size // 2])
    frames, report = read(bag, spacing_m=8.0)
    assert len(frames) >= 3
    assert report.problems
    assert all(str(problem).startswith("bag_1.mcap, at byte") for problem in report.problems)


@pytest.mark.parametrize("kind", ["sqlite", "ros1"])
def test_other_bags_are_joined_once_into_the_cache_and_told(tmp_path, monkeypatch, kind):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    if kind == "ros1":
        bag = write_ros1(tmp_path / "drive.bag", range(4))
    else:
        bag = write_ros2(tmp_path / "drive", range(4), StoragePlugin.SQLITE3)
    told = []
    log = readable_log(bag, told.append)
    assert log.name == "drive.mcap"
    assert log.is_relative_to(tmp_path / "cache")
    assert "joined to" in told[0]
    assert str(log) in told[0]
    assert_images(log, range(4))
    made = log.stat().st_mtime_ns
    assert readable_log(bag, told.append) == log
    assert log.stat().st_mtime_ns == made
    assert "made from it earlier" in told[1]


def test_a_bag_of_mcap_is_no_copy_and_has_the_fingerprint_of_its_part(tmp_path):
    bag = write_ros2(tmp_path / "bag", range(2), StoragePlugin.MCAP)
    assert readable_log(bag, pytest.fail) == bag
    (part,) = bag.glob("*.mcap")
    assert log_fingerprint(bag) == log_fingerprint(part)
    (bag / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=r"holds no metadata\.yaml\..*wayside import"):
        list(scan(bag, ScanReport()))


def test_the_command_names_the_bag_it_was_given_and_not_the_copy(tmp_path, monkeypatch, command):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    bag = write_ros1(tmp_path / "drive.bag", range(4))
    done = command("info", bag)
    assert f"wayside run {bag} -o out --spacing 26.4ft" in done.stdout
    assert "joined to" in done.stderr


def test_parts_of_mcap_keep_every_message_metadata_and_attachment(tmp_path):
    parts = []
    for number in range(2):
        parts.append(tmp_path / f"part_{number}.mcap")
        with parts[-1].open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            for unused in range(number):  # the parts number the same channel differently
                writer.register_channel(f"/none{unused}", "json", 0)
            schema = writer.register_schema("any.Type", "jsonschema", b"{}")
            channel = writer.register_channel("/any", "json", schema)
            for index in range(3):
                time = 10 * number + index
                writer.add_message(channel, time, f'{{"i": {time}}}'.encode(), time, time)
            writer.add_metadata(f"m{number}", {"part": str(number)})
            writer.add_attachment(0, 0, f"a{number}", "text/plain", b"attached")
            writer.finish()
    joined = join_logs(parts, tmp_path / "drive.mcap")
    assert (joined.messages, joined.topics, joined.lost) == (6, 1, ())
    with (tmp_path / "drive.mcap").open("rb") as stream:
        reader = make_reader(stream)
        found = [(c.topic, m.sequence, m.data) for _, c, m in reader.iter_messages()]
        assert [m.name for m in reader.iter_metadata()] == ["m0", "m1"]
        assert [a.name for a in reader.iter_attachments()] == ["a0", "a1"]
    times = [0, 1, 2, 10, 11, 12]
    assert found == [("/any", time, f'{{"i": {time}}}'.encode()) for time in times]


def test_what_of_a_part_is_cut_off_is_told_and_the_rest_is_joined(tmp_path):
    parts = []
    for name, indices in (("a", range(9)), ("b", range(9, 18))):
        parts += write_ros2(tmp_path / name, indices, StoragePlugin.MCAP).glob("*.mcap")
    parts[0].write_bytes(parts[0].read_bytes()[: parts[0].stat().st_size // 2])
    assert join_logs(parts, tmp_path / "drive.mcap").lost
    frames, _ = read(tmp_path / "drive.mcap", spacing_m=8.0)
    assert 9 < len(frames) < 18


@pytest.mark.parametrize("name", ["drive.bag", "drive.db3", "drive.mcap", "bag"])
def test_a_part_that_is_no_log_is_named(tmp_path, name):
    path = tmp_path / name
    path.mkdir() if name == "bag" else path.write_text("no log")
    with pytest.raises(InputError, match=name):
        join_logs([path], tmp_path / "out.mcap")
    with pytest.raises(InputError, match=r"xxx\.mcap: this is not an MCAP file.*too long"):
        join_logs([tmp_path / ("x" * 5000 + ".mcap")], tmp_path / "out.mcap")
    assert [p.name for p in tmp_path.iterdir()] == [name]
