"""Outlines and the curves of their terms."""

import numpy as np
import pytest

from wayside.pipeline.report_figures.shapes import evenly, misfit
from wayside.pipeline.view.drawing import CURVES, curve_of_terms

ANGLE = np.arange(64) * 2 * np.pi / 64


def polygon(corners):
    """A regular polygon at 64 equal steps along its sides."""
    ends = np.exp(2j * np.pi * np.arange(corners + 1) / corners)
    return np.interp(np.arange(64) * corners / 64, np.arange(corners + 1), ends.real) + 1j * (
        np.interp(np.arange(64) * corners / 64, np.arange(corners + 1), ends.imag)
    )


def test_a_circle_is_its_own_first_term_and_an_ellipse_the_first_two():
    circle = 3 + 2j + 5 * np.exp(1j * ANGLE)
    ellipse = 4 * np.exp(1j * ANGLE) + 1.5 * np.exp(-1j * ANGLE)
    assert misfit(circle, CURVES["circle"]) == pytest.approx(0, abs=1e-12)
    assert misfit(ellipse, CURVES["circle"]) > 0.1
    assert misfit(ellipse, CURVES["ellipse"]) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("corners", [3, 4, 5])
def test_six_terms_fit_what_has_corners_better_than_a_circle(corners):
    outline = polygon(corners)
    assert misfit(outline, CURVES["six_terms"]) < 0.6 * misfit(outline, CURVES["circle"])


def test_a_curve_keeps_the_middle_of_the_outline():
    outline = polygon(4) + 7 - 2j
    curve = curve_of_terms(outline[None], CURVES["six_terms"])[0]
    assert curve.mean() == pytest.approx(outline.mean())


def test_the_sample_of_fifty_is_even_along_the_drive():
    views = [[k] for k in range(101)]
    assert evenly(views, 3) == [[0], [50], [100]]
    assert evenly(views[:2], 50) == [[0], [1]]
    assert evenly([], 50) == []
