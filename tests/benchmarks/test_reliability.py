"""The demo drive with wrong clocks, order and positions, run as a user runs it."""

import pytest

SOUND = 10
"""Rows that the demo drive gives."""


@pytest.fixture(scope="module")
def attacks(load):
    return load("faulty_logs")


@pytest.fixture(scope="module")
def drives(load):
    return load("reliability_drives")


@pytest.fixture(scope="module")
def reference(drives, tmp_path_factory):
    out = tmp_path_factory.mktemp("reference") / "out"
    assert drives.run_attack(drives.DEMO, out, ()).status == 0
    return out


def test_a_log_written_anew_holds_the_messages_of_the_demo(attacks, drives, tmp_path):
    messages = attacks.read_log(drives.DEMO)
    attacks.write_log(tmp_path / "again.mcap", messages)
    again = attacks.read_log(tmp_path / "again.mcap")
    assert [(m.topic, m.log_ns, m.number) for m in again] == [
        (m.topic, m.log_ns, m.number) for m in messages
    ]
    assert all(a.data == b.data for a, b in zip(again, messages, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "status", "words"),
    [
        ("headers back an hour, log clock sound", 0, "12 of 24 header times"),
        ("messages reversed, fixes only", 0, ""),
        ("poses until image 16, no fixes", 0, ""),
        ("one pose off by 20 m", 0, "1 of 24 poses of /pose are at impossible places"),
        ("poses jump by 5 km and stay", 0, "12 of 24 poses of /pose are at impossible places"),
        ("all poses NaN", 4, "24 messages of /pose lost"),
        ("covariance 1e16 of all fixes", 0, "none of the 24 messages of /gps can be used"),
        ("calibrations NaN from the third", 4, "22 messages of /camera/calibration lost"),
    ],
)
def test_an_attack_is_told_and_costs_no_sign(
    attacks, drives, reference, tmp_path, name, status, words
):
    edit, options = attacks.ATTACKS[name]
    log = tmp_path / "demo.mcap"
    attacks.write_log(log, edit(attacks.read_log(drives.DEMO)))
    found = drives.run_attack(log, tmp_path / "out", options)
    assert (found.status, found.used, found.rows) == (status, 24, SOUND), found
    assert words in "; ".join(found.said)
    matched, worst_m = drives.compare(tmp_path / "out", reference)
    assert matched == SOUND
    assert worst_m < 0.5
