"""Placement rules: how they are read, what they say of signs, and the page and table of a drive."""

import json
import os
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from wayside.pipeline.checking.quantities import MISSED
from wayside.pipeline.checking.rules import read_rules
from wayside.pipeline.checking.verdicts import check_rows, from_edge, is_of
from wayside.schemas.errors import OutputError, UsageError
from wayside.schemas.sign_catalogue import CATALOGUE, US
from wayside.schemas.tables import CHECK_VERDICTS, CHECKS, SIGNS

from .results import frame_rows, invoke, make_log, sign_row, write_tables

FOOT = 0.3048
LIMIT = '[one]\nwords = "w"\nquantity = "bottom_m"\nleast = "5 ft"\n'


def row(sign_id="d-1", **changes):
    """A stop sign of 30 in, 8 ft above the road at the right, of which everything is known."""
    known = {"mutcd": "R1-1", "color": "red", "shape": "octagon", "panel_width_m": 0.762}
    known |= {"panel_height_m": 0.762, "bottom_m": 8 * FOOT, "up_m": 8 * FOOT + 0.381}
    known |= dict.fromkeys(("sigma_width_m", "sigma_height_m", "sigma_bottom_m"), 0.01)
    known |= {"station_m": 50.0, "lateral_m": 5.0, "facing_deg": 3.0, "sigma_facing_deg": 2.0}
    known |= {"sigma_lateral_m": 0.02, "sigma_along_m": 0.05, "code_probability": 0.99}
    return dict.fromkeys(SIGNS.schema.names) | sign_row(sign_id, **known | changes)


def rules_of(tmp_path, text):
    (tmp_path / "own.toml").write_text(text)
    return read_rules([str(tmp_path / "own.toml")])


@pytest.fixture
def checked(tmp_path):
    """Verdicts of the rules of a text by sign."""

    def check(text, *rows, road=None):
        found = check_rows(rows, rules_of(tmp_path, text), road)
        return {one.sign["sign_id"]: one for one in found}

    return check


def test_every_rule_that_ships_is_read_and_names_its_section_and_known_codes():
    rules = read_rules(["mutcd"])
    codes = {one.code for one in CATALOGUE[US]}
    assert len(rules) > 15
    for rule in rules:
        assert rule.section
        assert rule.edition.startswith("MUTCD, 11th")
        assert rule.level in ("shall", "should")
        for pattern in (*rule.codes, *rule.not_codes):
            assert any(re.fullmatch(pattern.replace("*", ".*"), code) for code in codes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LIMIT.replace('"w"', "3"), "words must be a text, but is 3"),
        (LIMIT.replace("words", "word"), "there is no key word; the keys are words, "),
        (LIMIT.replace('words = "w"\n', ""), "the key words is missing"),
        (LIMIT.replace("bottom_m", "botom_m"), "quantity: 'botom_m' is not one of: width_m, "),
        (LIMIT.replace("5 ft", "5 yd"), "least: '5 yd' is not a number with a unit"),
        (LIMIT.replace("5 ft", "5 deg"), "a limit of bottom_m is in m or ft or in, not deg"),
        (LIMIT.replace('"5 ft"', "5"), "least: 5 is not a number with a unit"),
        (LIMIT.replace('least = "5 ft"\n', ""), "it has no limit"),
        (LIMIT + 'most = "9 m"\n', "or limits in different units"),
        (LIMIT.replace('"5 ft"', '[["1 m", "5 ft"]]'), 'and end with ["", "limit"]'),
        (LIMIT.replace('"5 ft"', '["5 ft"]'), "['5 ft'] is not a list of pairs"),
        (LIMIT.replace('"5 ft"', '[["1 m", "5 ft"], ["", "6 ft"]]'), "name it with the key by"),
        (LIMIT + 'roads = ["lane"]\n', "roads: 'lane' is not one of: rural, urban, freeway"),
        (LIMIT + 'codes = "R1-1"\n', "codes must be a list of texts, but is 'R1-1'"),
        (LIMIT + "below_another = 1\n", "below_another must be true or false, but is 1"),
    ],
)
def test_a_rule_that_cannot_be_used_is_named_with_its_file_and_what_is_wrong(tmp_path, text, words):
    with pytest.raises(UsageError, match=re.escape(words)) as error:
        rules_of(tmp_path, text)
    assert str(error.value).startswith(f"rules {tmp_path / 'own.toml'}, rule [one]: ")


def test_a_file_that_is_missing_is_named():
    with pytest.raises(UsageError, match=r"rules none\.toml cannot be read.*or one of mutcd"):
        read_rules(["none.toml"])


def test_rules_of_a_later_file_replace_those_of_the_same_name_and_add_others(tmp_path):
    text = LIMIT.replace("[one]", "[height]").replace("5 ft", "6 ft") + LIMIT
    (tmp_path / "own.toml").write_text(text)
    both = {one.id: one for one in read_rules(["mutcd", str(tmp_path / "own.toml")])}
    assert both.keys() == {one.id for one in read_rules(["mutcd.toml"])} | {"one"}
    assert both["height"].least[0][1] == pytest.approx(6 * FOOT)
    assert (both["height"].level, both["height"].section) == ("own", "")


@given(st.floats(0.5, 4.0), st.floats(0.001, 0.3))
def test_a_verdict_is_sure_at_two_standard_deviations(tmp_path_factory, bottom_m, sigma_m):
    rules = rules_of(tmp_path_factory.getbasetemp(), LIMIT)
    (one,) = check_rows([row(bottom_m=bottom_m, sigma_bottom_m=sigma_m)], rules, None)
    off = (bottom_m - 5 * FOOT) / sigma_m
    assert one.verdict == ("meets" if off >= 2 else "fails" if off <= -2 else "unclear")
    assert one.probability == pytest.approx(norm.cdf(-off), abs=1e-9)


def test_both_ends_of_a_range_and_the_tolerance_count(checked):
    text = '[one]\nwords = "w"\nquantity = "facing_deg"\nleast = "-15 deg"\nmost = "15 deg"\n'
    turned = [row(str(deg), facing_deg=float(deg)) for deg in (-25, -16, 0, 14, 25)]
    found = checked(text, *turned)
    assert [one.verdict for one in found.values()] == "fails unclear meets unclear fails".split()
    assert found["0"].said == "0.0 ± 2 deg, at least -15 and at most 15"
    found = checked(text.replace("[one]", '[one]\ntolerance = "15 deg"'), *turned)
    assert [one.verdict for one in found.values()][:2] == ["meets", "meets"]


def test_a_limit_by_a_radius_weighs_what_the_radius_can_be(checked):
    text = (
        '[one]\nwords = "w"\nquantity = "spacing_m"\nby = "curve_radius_m"\nnext_within = "100 m"\n'
    )
    text += 'most = [["200 ft", "40 ft"], ["400 ft", "80 ft"], ["", "200 ft"]]\n'
    near = {"next_sign_id": "x", "sigma_spacing_m": 0.1, "radius_m": -300 * FOOT}
    rows = [
        row("keeps", spacing_m=79 * FOOT, sigma_radius_m=1.0, **near),
        row("wide", spacing_m=82 * FOOT, sigma_radius_m=1.0, **near),
        row("unsure", spacing_m=82 * FOOT, sigma_radius_m=40.0, **near),
        row("straight", spacing_m=20.0, sigma_spacing_m=0.1, next_sign_id="y"),
        row("other curve", spacing_m=120.0, sigma_radius_m=1.0, **near),
    ]
    found = checked(text, *rows)
    assert {name: one.verdict for name, one in found.items()} == {
        "keeps": "meets",
        "wide": "unclear",  # a chevron between may have been missed
        "unsure": "unclear",
        "straight": "not checkable",
    }
    assert found["wide"].most == pytest.approx(80 * FOOT)
    assert found["wide"].probability == pytest.approx(1 - MISSED)
    ends = [row("a", **near | {"next_sign_id": "b"}, spacing_m=20.0, sigma_radius_m=1.0)]
    ends.append(row("b", radius_m=150 * FOOT, sigma_radius_m=1.0))
    assert checked(text, *ends)["a"].most == pytest.approx(40 * FOOT)


def test_a_panel_below_another_has_its_own_limit(checked):
    upper, lower = row("upper", up_m=3.0), row("lower", up_m=2.0, assembly_id="upper")
    for below, names in (("true", {"lower"}), ("false", {"upper"})):
        assert checked(f"{LIMIT}below_another = {below}\n", upper, lower).keys() == names


def test_a_rule_holds_on_its_kind_of_road_and_for_its_side_look_and_system(checked):
    text = LIMIT + 'roads = ["urban"]\n'
    assert checked(text, row())["d-1"].missing == "the kind of road"
    assert checked(text, row(), road="urban")["d-1"].verdict == "meets"
    assert not checked(text, row(), road="rural")
    for condition in ('sides = ["left"]', 'colors = ["white"]', 'shapes = ["circle"]'):
        assert not checked(LIMIT + condition, row())
        assert checked(LIMIT + condition, row(lateral_m=-5.0, color="white", shape="circle"))
    assert not checked(LIMIT + 'system = "us"', row(mutcd=None, vienna="B2"))
    assert checked(LIMIT + 'colors = ["white"]', row(color=None))["d-1"].missing == "its color"


def test_the_size_of_a_diamond_is_the_side_of_its_square(checked):
    text = '[one]\nwords = "w"\nquantity = "width_m"\nleast = "30 in"\ntolerance = "3 in"\n'
    sizes = {"24": 0.8, "30": 1.04, "square": 0.8}
    rows = [row(name, shape="diamond", panel_width_m=width) for name, width in sizes.items()]
    rows[2]["shape"] = "rectangle"
    found = checked(text, *rows)
    assert [one.verdict for one in found.values()] == ["fails", "meets", "meets"]


def test_a_pair_stands_across_the_road(checked):
    text = '[one]\nwords = "w"\nquantity = "pair_m"\nmost = "20 ft"\n'
    rows = [row("right"), row("left", lateral_m=-6.0, station_m=53.0), row("alone", mutcd="R5-1")]
    rows.append(row("far", lateral_m=5.0, station_m=400.0))
    found = checked(text, *rows)
    assert [one.verdict for one in found.values()] == ["meets", "meets", "not checkable", "unclear"]
    assert found["alone"].said == "not known: one of its type on the other side"


def test_the_edge_of_the_travelled_way_is_that_abreast_of_the_sign_on_its_side(checked):
    edges = [
        {"station_m": 48.0, "side": "right", "edge_m": 1.5},
        {"station_m": 50.0, "side": "left", "edge_m": 9.0},
        {"station_m": 56.0, "side": "right", "edge_m": None},
    ]
    sign = row()
    assert from_edge(sign, edges)["offset_edge_m"] == pytest.approx(5.0 - 0.381 - 1.5)
    (one,) = checked(
        '[one]\nwords = "w"\nquantity = "offset_m"\nleast = "12 ft"\n',
        sign | from_edge(sign, edges),
    ).values()
    assert one.verdict == "fails"
    assert from_edge(row(station_m=60.0), edges) == from_edge(row(lateral_m=None), edges) == {}


def test_what_a_rule_lacks_is_said(checked):
    lacks = {"bottom_m": "bottom_m", "sigma_facing_deg": "facing_deg", "spacing_m": "spacing_m"}
    for column, quantity in (lacks | {"offset_edge_m": "offset_m"}).items():
        unit = "deg" if quantity.endswith("_deg") else "ft"
        text = f'[one]\nwords = "w"\nquantity = "{quantity}"\nleast = "5 {unit}"\n'
        one = checked(text, row(**{column: None}))["d-1"]
        assert one.verdict == "not checkable"
        assert one.missing == lacks.get(column, "the edge of the travelled way")
        assert np.isnan(one.probability)


@pytest.mark.parametrize(
    ("changes", "patterns", "is_one"),
    [
        ({}, ["R1-1"], True),
        ({}, ["R1-2"], False),
        ({"mutcd": "W1-8"}, ["W*"], True),
        ({"mutcd": "W"}, ["W*"], True),
        # a series says as little of its codes as look and size allow
        ({"mutcd": "W", "color": "yellow", "shape": "diamond"}, ["W1-8"], False),
        ({"mutcd": "W", "color": "yellow", "shape": "diamond"}, ["W2-2"], None),
        ({"mutcd": None}, ["R1-1"], None),
        ({"mutcd": None}, ["R2-1"], False),
        ({"mutcd": "D", "color": "green", "shape": "rectangle", "panel_width_m": 2.0}, ["D10"], False),
        ({"mutcd": "D/E/I", "color": "green", "shape": "rectangle", "panel_width_m": 0.3}, ["D10"], None),
        ({"mutcd": None, "vienna": "B2"}, ["R1-1"], False),
    ],
)  # fmt: skip
def test_a_code_that_is_not_settled_may_be_one_that_looks_alike(changes, patterns, is_one):
    assert is_of(row(**changes), patterns) is is_one


LOW, HIGH = 4 * FOOT, 8 * FOOT


@pytest.fixture
def out(tmp_path):
    """A result with a face that stands too low, one that does not, and a back, and its log."""
    images = [np.full((120, 160, 3), 90 + n, np.uint8) for n in range(3)]
    log = make_log(tmp_path / "d.mcap", images)
    seen = {"log": "d", "best_frame": 1, "best_box": [60.0, 40.0, 76.0, 54.0]}
    rows = [row("d-0001", bottom_m=LOW, **seen), row("d-0002", bottom_m=HIGH, **seen)]
    rows.append(row("d-0003", bottom_m=LOW, status="back", **seen))
    settings = {"read": {"spacing_m": 8.0, "thin_m": 0.0}}
    about = {"log": "d.mcap", "log_path": str(log), "world": "log", "settings": settings}
    return write_tables(tmp_path / "out", rows, frames=frame_rows(log, y=0.0, z=0.0), **about)


def test_one_command_lists_what_stands_too_low_and_shows_it(out):
    said = invoke("check", out, "--only", "height")
    assert re.search(r"^height +1 +1 ", said, re.MULTILINE)
    assert re.search(r"fails\n  height +d-0001  R1-1 +4\.0 ± 0\.033 ft, at least 5\n", said)
    assert f"open {out / 'checks.html'}" in said
    page = (out / "checks.html").read_text()
    assert '<a href="evidence/d-0001.html">d-0001</a>' in page
    assert (out / "evidence" / "d-0001.html").is_file()
    assert page.count('src="data:image/webp') == 1
    assert "2A.15 p4" in page
    assert "d-0003" not in page
    (out / "evidence" / "d-0001.html").unlink()
    os.utime(out / "run.json", (4e9, 4e9))  # of a later run, whose evidence is not there
    invoke("check", out)
    assert (out / "evidence" / "d-0001.html").is_file()


def test_the_table_holds_each_check_and_the_same_bytes_once_more(out):
    invoke("check", out)
    table = pq.read_table(out / CHECKS.file)
    assert table.schema.equals(CHECKS.schema, check_metadata=True)
    rows = {(one["rule"], one["sign_id"]): one for one in table.to_pylist()}
    low = rows["height", "d-0001"]
    assert (low["verdict"], low["section"], low["quantity"]) == ("fails", "2A.15 p4", "bottom_m")
    assert (low["value"], low["least"]) == pytest.approx((LOW, 5 * FOOT))
    assert low["probability"] > 0.999
    assert rows["size_stop", "d-0002"]["verdict"] == "meets"
    assert rows["offset", "d-0001"]["missing"] == "the edge of the travelled way"
    assert {one["verdict"] for one in rows.values()} <= {*CHECK_VERDICTS}
    before = (out / CHECKS.file).read_bytes(), (out / "checks.html").read_bytes()
    invoke("check", out)
    assert before == ((out / CHECKS.file).read_bytes(), (out / "checks.html").read_bytes())


def test_without_its_log_the_page_lacks_images_and_the_command_says_so(out):
    about = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps(about | {"log_path": "/none.mcap"}))
    assert "the page lacks images or evidence" in invoke("check", out, status=4)
    assert "<img" not in (out / "checks.html").read_text()
    assert pq.read_table(out / CHECKS.file).num_rows > 0


def test_files_of_the_user_are_not_replaced(out):
    (out / "checks.html").write_text("mine")
    with pytest.raises(OutputError, match=r"checks\.html"):
        invoke("check", out)
    invoke("check", out, "--overwrite")
    with pytest.raises(UsageError, match="--only nothing"):
        invoke("check", out, "--only", "nothing")
