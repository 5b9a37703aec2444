import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.files.lengths import parse_length, parse_memory, parse_time
from wayside.schemas.errors import UsageError

UNDERSTOOD = {
    parse_length: {
        **{"26.4ft": 8.04672, "26.4 feet": 8.04672, "26.4'": 8.04672, "1 foot": 0.3048},
        **{"8 m": 8.0, "8.05m": 8.05, " 8 Metres ": 8.0, ".5m": 0.5, "0m": 0.0},
    },
    parse_time: {
        **{"1:30": 90, "90s": 90, "90": 90, "1.5 s": 1.5, "1:02:03.5": 3723.5, "75:00": 4500}
    },
    parse_memory: {"2GB": 2000, "500 MB": 500, "1.5gb": 1500, "1MiB": 1.048576},
}
REFUSED = {
    parse_length: ("8", "", "ft", "8 km", "8m6", "-8m", "eight m", "1e999m", "nan m"),
    parse_time: ("", "-1", "1:60", "1:75:00", "1:2:3:4", "soon", "1m30"),
    parse_memory: ("2", "", "GB", "-1GB", "0MB", "2 parsecs", "nan GB", "1e999GB"),
}
FORMS = {
    parse_length: r"as in 26\.4ft or 8\.05m|such as 8m",
    parse_time: "1:30",
    parse_memory: "2GB",
}


@pytest.mark.parametrize("parse", UNDERSTOOD)
def test_lengths_times_and_sizes_are_understood_with_their_units(parse):
    for text, value in UNDERSTOOD[parse].items():
        assert parse(text, "--option") == pytest.approx(value, abs=1e-12), text


@pytest.mark.parametrize(("parse", "text"), [(p, text) for p in REFUSED for text in REFUSED[p]])
def test_another_text_is_refused_with_the_forms_understood(parse, text):
    with pytest.raises(UsageError, match=f"^--option: .*({FORMS[parse]})"):
        parse(text, "--option")


@given(st.floats(0, 1e6))
def test_metres_written_out_come_back(metres):
    assert parse_length(f"{metres!r} m", "--option") == metres
