import json

from wayside.pipeline.logs.information import format_log, inspect_log

from ..results import invoke

PLACES = {
    "pose": lambda index: {"position": [8 * index, 0, 0], "rotation": [0, 0, 0, 1]},
    "fix": lambda index: {"place": (48.0, 11.0 + index * 1e-4, 500.0)},
}


def test_a_usable_log_is_described_with_the_command_that_uses_it(new_log, dialect):
    path = new_log(dialect).drive(8, **PLACES)
    text = format_log(inspect_log(path))
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
    facts = json.loads(invoke("info", path, "--json"))
    assert [one["used_for"] for one in facts["topics"]].count("images") == 1
    assert facts["cameras"][0]["command"] == f"wayside run {path} -o out"
    assert facts["cameras"][0]["calibration"]["fx"] == 40.0


def test_what_is_missing_stands_in_the_command(new_log):
    path = new_log().drive(8, calibration=None)
    text = format_log(inspect_log(path))
    command = f"wayside run {path} -o out --calibration camera.yaml --spacing 26.4ft"
    assert f"add what is missing: {command}" in text
    assert "can be used:" not in text


def test_each_of_several_cameras_has_its_command(new_log):
    log = new_log().calibrated()
    log.add_image(0, topic="/front")
    log.add_image(0, topic="/rear")
    text = format_log(inspect_log(log.finish()))
    assert "--camera /front -o out" in text
    assert "--camera /rear -o out" in text


def test_damage_is_listed_and_the_rest_described(new_log):
    path = new_log(chunk_size=3000).drive(8, **PLACES)
    content = bytearray(path.read_bytes())
    path.write_bytes(content[: len(content) * 2 // 3])
    text = format_log(inspect_log(path))
    assert "damaged in 1 place;" in text
    assert "at byte" in text
    assert "can be used:" in text


def test_of_very_many_topics_a_bounded_number_is_described(new_log):
    log = new_log("json")
    for index in range(300):
        log.add_image(index, topic=f"/c{index}")
    lines = format_log(inspect_log(log.finish())).splitlines()
    assert len(lines) < 150
    assert "and 200 more topics" in lines
    assert "and 294 more cameras" in lines
