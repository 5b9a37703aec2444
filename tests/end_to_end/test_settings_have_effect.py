"""Settings of numerics that lie several calls below the flow: they change the stated errors of boxes that are given."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import wayside

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
Sigmas = Callable[[dict[str, object]], list[float]]


@pytest.fixture(scope="module")
def sigmas(true_boxes: list[dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> Sigmas:
    """The stated error along the road of every sign at the start of the demo drive."""
    boxes = tmp_path_factory.mktemp("boxes") / "boxes.parquet"
    pq.write_table(pa.Table.from_pylist(true_boxes), boxes)

    def run(settings: dict[str, object]) -> list[float]:
        found = wayside.run(DEMO, detections=boxes, settings={"read.until_s": 0.5, **settings})
        return [round(value, 9) for value in found.signs["sigma_along_m"].to_pylist()]

    return run


@pytest.fixture(scope="module")
def unchanged(sigmas: Sigmas) -> list[float]:
    found = sigmas({})
    assert found
    return found


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
    setting: str, value: float, sigmas: Sigmas, unchanged: list[float]
) -> None:
    assert sigmas({setting: value}) != unchanged
