import pytest

from wayside.pipeline.logs.information import describe_log
from wayside.schemas.errors import InputError

STEP = 10**9 // 4


def fill(log, *, calibration=True, poses=True, topics=("/camera/image",)):
    for index in range(8):
        if calibration:
            log.add("/camera/calibration", "calibration", index * STEP)
        if poses:
            log.add(
                "/pose", "pose", index * STEP, position=[8 * index, 0, 0], rotation=[0, 0, 0, 1]
            )
            log.add("/gps", "fix", index * STEP, place=(48.0, 11.0 + index * 1e-4, 500.0))
        for topic in topics:
            log.add_image(index, topic=topic)
    return log.finish()


def test_a_usable_log_is_described_with_the_command_that_uses_it(new_log, dialect):
    path = fill(new_log(dialect))
    text = describe_log(path)
    for words in (
        " 1.8 s, 32 messages",
        "zstd",
        "8         4.0 Hz",
        "32 x 24, jpeg",
        "focal length 40.0 41.0 px",
        "motion from poses /pose, fixes /gps",
        f"can be used: wayside run {path} -o out",
        "no damage found",
    ):
        assert words in text


def test_what_is_missing_stands_in_the_command(new_log):
    path = fill(new_log(), calibration=False, poses=False)
    text = describe_log(path)
    command = f"wayside run {path} -o out --calibration camera.yaml --spacing 26.4ft"
    assert f"with what is missing: {command}" in text
    assert "can be used:" not in text


def test_each_of_several_cameras_has_its_command(new_log):
    text = describe_log(fill(new_log(), topics=("/front", "/rear")))
    assert "--camera /front -o out" in text
    assert "--camera /rear -o out" in text


def test_a_calibration_of_another_size_is_told(new_log):
    log = new_log().calibrated(width=64, height=48)
    log.add("/pose", "pose", 0, position=[0, 0, 0], rotation=[0, 0, 0, 1])
    log.add_image(0)
    text = describe_log(log.finish())
    assert "64 x 48" in text
    assert "--calibration camera.yaml" in text


def test_a_log_without_images_says_what_is_needed(new_log):
    log = new_log().calibrated()
    text = describe_log(log.finish())
    assert "cannot be used: the log has no images" in text


def test_an_unusable_calibration_says_why(new_log):
    log = new_log().calibrated(model="equidistant")
    log.add("/pose", "pose", 0, position=[0, 0, 0], rotation=[0, 0, 0, 1])
    log.add_image(0)
    text = describe_log(log.finish())
    assert "lens model equidistant is not understood" in text


def test_damage_is_listed_and_the_rest_described(new_log):
    path = fill(new_log(chunk_size=3000))
    content = bytearray(path.read_bytes())
    path.write_bytes(content[: len(content) * 2 // 3])
    text = describe_log(path)
    assert "damaged in 1 place;" in text
    assert "at byte" in text
    assert "can be used:" in text


def test_a_file_that_is_no_log_is_refused(tmp_path):
    (tmp_path / "log.mcap").write_bytes(b"something else")
    with pytest.raises(InputError, match="not an MCAP log"):
        describe_log(tmp_path / "log.mcap")


def test_of_very_many_topics_a_bounded_number_is_described(new_log):
    log = new_log("json")
    for index in range(300):
        log.add_image(index, topic=f"/c{index}")
    lines = describe_log(log.finish()).splitlines()
    assert len(lines) < 150
    assert "and 200 more topics" in lines
    assert "and 294 more cameras" in lines
