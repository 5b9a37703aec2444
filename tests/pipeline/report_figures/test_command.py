"""The command on the demo drive."""

import re
from pathlib import Path

import pytest

from wayside.pipeline.report_figures.command import PAGE, write_figures
from wayside.pipeline.report_figures.drive import labels_beside
from wayside.schemas.errors import InputError, OutputError

DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"
NUMBERS = (
    *(
        "2.1",
        "2.2",
        "2.3",
        "3.1",
        "3.2",
        "3.3",
        "3.4",
        "4.1",
        "4.2",
        "4 (claim)",
        "5.2",
        "5.3, 5.4",
    ),
    *("6.1", "7.2", "8.3 to 8.5", "8.6", "9.1", "9.2", "9.3", "9.4", "9.5", "9.6"),
    *("10.1", "10.1 (matrix)", "11.1", "11.2", "11 (claim)"),
)


def test_labels_beside_the_log_are_found_and_asked_for_where_there_are_none(tmp_path):
    assert labels_beside(DEMO).name == "demo.truth.json"
    with pytest.raises(InputError, match=r"alone\.labels\.json.*--labels"):
        labels_beside(tmp_path / "alone.mcap")


@pytest.mark.slow
def test_every_figure_is_made_or_says_what_it_needs(tmp_path):
    page, figures = write_figures(DEMO, tmp_path, assignments=["read.until_s=3"])
    assert page == tmp_path / PAGE
    assert tuple(figure.number for figure in figures) == NUMBERS
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
