import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.files.lengths import parse_length, parse_memory, parse_time
from wayside.schemas.errors import UsageError


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("26.4ft", 8.04672),
        ("26.4 feet", 8.04672),
        ("26.4'", 8.04672),
        ("8 m", 8.0),
        ("8.05m", 8.05),
        (" 8 Metres ", 8.0),
        ("1 foot", 0.3048),
        (".5m", 0.5),
        ("0m", 0.0),
    ],
)
def test_a_length_is_understood_in_feet_and_metres(text, metres):
    assert parse_length(text) == pytest.approx(metres, abs=1e-12)


@pytest.mark.parametrize(
    "text", ["8", "", "ft", "8 km", "8m6", "-8m", "eight m", "1e999m", "nan m"]
)
def test_what_is_no_length_is_refused_with_the_forms_understood(text):
    with pytest.raises(UsageError, match=r"m"):
        parse_length(text)


@given(st.floats(0, 1e6))
def test_metres_written_out_come_back(metres):
    assert parse_length(f"{metres!r} m") == metres


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("1:30", 90), ("90s", 90), ("90", 90), ("1.5 s", 1.5), ("1:02:03.5", 3723.5), ("75:00", 4500)],
)
def test_a_time_is_understood_in_seconds_and_minutes(text, seconds):
    assert parse_time(text) == seconds


@pytest.mark.parametrize("text", ["", "-1", "1:60", "1:75:00", "1:2:3:4", "soon", "1m30"])
def test_what_is_no_time_is_refused_with_the_forms_understood(text):
    with pytest.raises(UsageError, match="1:30"):
        parse_time(text)


@pytest.mark.parametrize(
    ("text", "megabytes"), [("2GB", 2000), ("500 MB", 500), ("1.5gb", 1500), ("1MiB", 1.048576)]
)
def test_a_size_is_understood_with_its_unit(text, megabytes):
    assert parse_memory(text) == pytest.approx(megabytes)


@pytest.mark.parametrize("text", ["2", "", "GB", "-1GB", "0MB", "2 parsecs", "nan GB", "1e999GB"])
def test_what_is_no_size_is_refused_with_the_forms_understood(text):
    with pytest.raises(UsageError, match="2GB"):
        parse_memory(text)
