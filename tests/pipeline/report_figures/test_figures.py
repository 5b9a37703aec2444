"""Plots, pictures, outlines and the page of the report's figures; the command on the demo drive."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.files.pictures import is_marked
from wayside.pipeline.learning.page import Figure, Picture, new_axes, png, svg
from wayside.pipeline.pages import render_page
from wayside.pipeline.report_figures.command import MARK, PAGE, write_figures
from wayside.pipeline.report_figures.drive import around, cut, evenly, labels_beside, photo, reached
from wayside.pipeline.statistics import rate_words, share_words
from wayside.schemas.errors import InputError, OutputError, UsageError


def test_the_sample_of_fifty_is_even_along_the_drive():
    views = [[k] for k in range(101)]
    assert evenly(views, 3) == [[0], [50], [100]]
    assert evenly(views[:2], 50) == [[0], [1]]
    assert evenly([], 50) == []


def test_a_line_is_broken_where_a_value_is_unknown_and_names_are_escaped():
    axes = new_axes((0, 4), (0, 1), ("x", "y"))
    axes.plot([0, 1, 2, 3, 4], [0, 1, np.nan, 0, 1], color="#123456", label="a < b")
    html = svg(axes, "words").html
    lines = re.findall(r'<path d="([^"]*)"[^>]*stroke: #123456', html)
    assert sorted(line.count("M") for line in lines) == [1, 2]  # that of the legend, and the line
    assert "a &lt; b" in html
    assert "nan" not in html


def test_a_plot_names_nothing_from_elsewhere_and_is_the_same_each_time():
    def drawn():
        axes = new_axes((0, 1), (0, 1), ("x", "y"), (540, 340))
        axes.plot([-5, 9], [0.5, 0.5], label="a line")
        return svg(axes).html, png(axes)

    html, image = drawn()
    assert (html, image) == drawn()
    assert html.startswith("<svg")
    assert "http" not in html
    assert cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR).shape == (340, 540, 3)


def test_axes_of_the_same_scale_keep_a_square_square():
    axes = new_axes((0, 10), (0, 1), ("x", "y"), equal=True)
    png(axes)
    (x0, y0), (x1, _), (_, y2) = axes.transData.transform([(0, 0), (1, 0), (0, 1)])
    assert x1 - x0 == pytest.approx(y2 - y0)


@given(x=st.floats(-50, 250), y=st.floats(-50, 150), wide=st.floats(1, 90), tall=st.floats(1, 90))
def test_a_cut_out_lies_inside_of_the_image(x, y, wide, tall):
    image = np.zeros((120, 200, 3), np.uint8)
    corners = around((x, y, x + wide, y + tall), image.shape[:2])
    assert 0 <= corners[0] < corners[2] <= 200
    assert 0 <= corners[1] < corners[3] <= 120
    assert cut(image, corners, 50).shape[0] == 50


def test_the_page_bears_its_mark_and_says_what_a_figure_needs(tmp_path):
    shown = Figure("2.1", "a & b", "k < 16", "ours", (photo(np.zeros((4, 4, 3), np.uint8), "x"),))
    missing = Figure("6.1", "boards", "none", needs="images of a board")
    rates = {"table": (("a",), ("<1",)), "claim": "not met"}
    told = Figure("10.1 (x)", "rates", "1.8 %", "2 %", (Picture("<svg></svg>"),), **rates)
    page = tmp_path / "page.html"
    chapters = [("2", [shown, missing]), ("10", [told])]
    html = render_page("figures.html", MARK, title="drive", intro=["words"], chapters=chapters)
    page.write_text(html)
    assert is_marked(page, MARK)
    assert "a &amp; b" in html
    assert "k &lt; 16" in html
    assert "left out: images of a board" in html
    assert "<td>&lt;1</td>" in html
    links = re.findall(r'href="#([^"]*)"', html)
    assert set(links) == set(re.findall(r'<section id="([^"]*)"', html))
    assert re.findall(r'(?:src|href)="(?!data:|#)', html) == []
    summary = re.findall(r"<td[^>]*>(.*?)</td>", html.split("<nav>")[0], re.DOTALL)
    words = [re.sub("<.*?>", "", one) for one in summary]
    assert words == ["10.1 (x)", "rates", "not met", "1.8 %", "2 %"]


def test_a_claim_is_open_where_only_the_interval_holds_its_number():
    assert [reached(n, 50, 0.92) for n in (46, 44, 40)] == ["met", "open", "not met"]
    assert [reached(n, 50, 1.0) for n in (50, 49)] == ["met", "not met"]
    assert reached(0, 0, 0.92) == "open"


def test_the_page_fits_a_phone_and_a_wide_screen(tmp_path, in_browser):
    axes = new_axes((0, 1), (0, 1), ("x", "y"))
    pictures = svg(axes), photo(np.zeros((40, 1000, 3), np.uint8))
    wide = Figure("2.1", "one", "a", "b", pictures, claim="met", table=(("w" * 60,) * 9,))
    narrow = (Figure(str(k), "two", "a", "b", pictures[:1]) for k in range(2))
    chapters = [("2", [wide, *narrow])]
    page = tmp_path / "page.html"
    page.write_text(render_page("figures.html", MARK, title="a", intro=[], chapters=chapters))
    script = """
      const left = (id) => document.getElementById(id).getBoundingClientRect().left;
      document.body.style.width = "%dpx";
      return [left("figure-0") < left("figure-1"), document.querySelector(".chapter").scrollWidth];
    """
    assert in_browser(page, script % 1500) == [True, 1500 - 32]  # less what the page leaves beside
    assert in_browser(page, script % 360) == [False, 360 - 32]


DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"


def test_labels_beside_the_log_are_found_and_asked_for_where_there_are_none(tmp_path):
    assert labels_beside(DEMO).name == "demo.truth.json"
    with pytest.raises(InputError, match=r"alone\.labels\.json.*--labels"):
        labels_beside(tmp_path / "alone.mcap")
    with pytest.raises(UsageError, match="are not blurred"):
        write_figures(DEMO, tmp_path, assignments=["read.blur=true"])


@pytest.mark.slow
def test_every_figure_is_made_or_says_what_it_needs(tmp_path):
    page, figures = write_figures(DEMO, tmp_path, assignments=["read.until_s=3"])
    assert page == tmp_path / PAGE
    assert {figure.number for figure in figures if figure.needs} == {"6.1"}
    html = page.read_text()
    assert "nan" not in re.sub(r"base64,[^\"]*", "", html)
    assert html.count("<img") > 10
    assert html.count("<svg") > 5
    assert "167.73" in html
    assert "190.77" in html
    page.write_text("mine")
    with pytest.raises(OutputError, match="--overwrite"):
        write_figures(DEMO, tmp_path, assignments=["read.until_s=1"])


def test_shares_and_rates_stand_with_their_intervals():
    assert share_words(46, 50) == "46 of 50, 92 % (81 to 97)"
    assert share_words(0, 0) == "0 of 0"
    assert rate_words(0, 100) == "0 in 100 images, 0.0 per 100 (0.0 to 3.7)"
