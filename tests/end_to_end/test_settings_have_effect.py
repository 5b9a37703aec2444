"""Settings of numerics that lie several calls below the flow."""

from pathlib import Path

import pytest

import wayside

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"


def sigmas(settings: dict[str, object]) -> list[float]:
    """The stated error along the road of every sign at the start of the demo drive."""
    found = wayside.run(DEMO, settings={"read.until_s": 0.7, "models.network": "", **settings})
    return [round(value, 9) for value in found.signs["sigma_along_m"].to_pylist()]


@pytest.fixture(scope="module")
def unchanged() -> list[float]:
    return sigmas({})


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("adjustment.cauchy_sigmas", 1.0),
        ("adjustment.window_iterations", 1),
        ("adjustment.point_iterations", 1),
        ("ties.correlation_reach_px", 1000.0),
        ("ties.sigma_px", 0.5),
        ("ties.scatter_quantile", 0.99),
    ],
)
def test_a_setting_far_below_the_flow_changes_the_errors(
    setting: str, value: float, unchanged: list[float]
) -> None:
    assert sigmas({setting: value}) != unchanged
