"""Plots, pictures and the page of the report's figures."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.file_marks import is_marked
from wayside.pipeline.report_figures.drawing import around, beside, cut
from wayside.pipeline.report_figures.numbers import rate_words, share_words
from wayside.pipeline.report_figures.page import MARK, Figure, Picture, format_page, photo
from wayside.pipeline.report_figures.plots import Plot, round_steps

numbers = st.floats(-1e6, 1e6, allow_nan=False)


@given(low=numbers, width=st.floats(1e-3, 1e6))
def test_steps_of_an_axis_are_round_evenly_spaced_and_inside(low, width):
    steps = round_steps(low, low + width)
    assert 1 <= len(steps) <= 9
    assert min(steps) >= low - 1e-6 * width - 1e-9
    assert max(steps) <= low + width + 1e-6 * width + 1e-9
    if len(steps) > 1:
        apart = np.diff(steps)
        first = f"{apart[0]:.6e}"[0]
        assert first in "1259" or np.isclose(apart[0], float(f"{apart[0]:.0e}"))
        np.testing.assert_allclose(apart, apart[0], rtol=1e-3)


def test_a_line_is_broken_where_a_value_is_unknown_and_names_are_escaped():
    plot = Plot((0, 4), (0, 1), ("x", "y"))
    plot.line([(0, 0), (1, 1), (2, np.nan), (3, 0), (4, 1)], "#000000", "a < b")
    html = plot.picture("words").html
    assert html.count("<polyline") == 2
    assert "a &lt; b" in html
    assert "nan" not in html


def test_no_tick_reads_minus_zero_and_what_is_outside_of_the_axes_is_cut_off():
    assert next(f"{step:g}" for step in round_steps(-0.3, 5)) == "0"
    plot = Plot((0, 1), (0, 1), ("x", "y"), (540, 340))
    plot.line([(-5, 0.5), (9, 0.5)], "#123456")
    html = plot.picture().html
    inner = html[html.index("<svg", 1) : html.index("</svg>")]
    assert 'x="62.0" y="12.0" width="464.0" height="284.0"' in inner
    assert "#123456" in inner
    assert html.count("#123456") == 1


def test_axes_of_the_same_scale_keep_a_square_square():
    plot = Plot((0, 10), (0, 1), ("x", "y"), equal=True)
    plot.points([(0, 0), (1, 0), (0, 1)], "#000000")
    dots = re.findall(r'cx="([0-9.]+)" cy="([0-9.]+)"', plot.picture().html)
    (x0, y0), (x1, _), (_, y2) = [(float(x), float(y)) for x, y in dots]
    assert x1 - x0 == pytest.approx(y0 - y2, abs=0.2)


@given(x=st.floats(-50, 250), y=st.floats(-50, 150), wide=st.floats(1, 90), tall=st.floats(1, 90))
def test_a_cut_out_lies_inside_of_the_image(x, y, wide, tall):
    image = np.zeros((120, 200, 3), np.uint8)
    corners = around((x, y, x + wide, y + tall), image.shape[:2])
    assert 0 <= corners[0] < corners[2] <= 200
    assert 0 <= corners[1] < corners[3] <= 120
    assert cut(image, corners, 50).shape[0] == 50


def test_pictures_stand_in_rows():
    tiles = [np.zeros((10, 20, 3), np.uint8)] * 5
    assert beside(tiles, 3).shape == (26, 72, 3)


def test_the_page_bears_its_mark_and_says_what_a_figure_needs(tmp_path):
    shown = Figure("2.1", "a & b", "k < 16", "ours", (photo(np.zeros((4, 4, 3), np.uint8), "x"),))
    missing = Figure("6.1", "boards", "none", needs="images of a board")
    told = Figure("10.1", "rates", "1.8 %", "x", (Picture("<svg></svg>"),), table=(("a",), ("<1",)))
    page = tmp_path / "page.html"
    page.write_text(format_page("drive", "words", [("2", [shown, missing]), ("10", [told])]))
    html = page.read_text()
    assert is_marked(page, MARK)
    assert "a &amp; b" in html
    assert "k &lt; 16" in html
    assert "left out: images of a board" in html
    assert "<td>&lt;1</td>" in html
    assert re.findall(r'(?:src|href)="(?!data:)', html) == []


def test_shares_and_rates_stand_with_their_intervals():
    assert share_words(46, 50) == "46 of 50, 92 % (81 to 97)"
    assert share_words(0, 0) == "0 of 0"
    assert rate_words(0, 100) == "0 in 100 images, 0.0 per 100 (0.0 to 3.7)"
