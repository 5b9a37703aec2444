"""Windows of candidates made of exact geometry: cameras straight ahead, 8 m apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from wayside.schemas.models import EvidenceModel
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping.association import WindowCandidates
from wayside.stages.mapping.landmark_evidence import FEATURES

Boxes = Sequence[Sequence[tuple[float, ...]]]
"""For each frame: right, down, depth, width, height, score in the frame of its camera."""


def made_window(boxes: Boxes, noise_px: float = 0.0) -> WindowCandidates:
    n, rng = len(boxes), np.random.default_rng(2)
    flat = np.array([b for frame in boxes for b in frame], float).reshape(-1, 6)
    noise = rng.normal(0, noise_px / 1400, (len(flat), 2))
    return WindowCandidates(
        rotation=np.repeat(np.eye(3)[None], n, axis=0),
        centre=np.array([[0.0, 0.0, 8.0 * k] for k in range(n)]),
        focal=np.full(n, 1400.0),
        bounds=np.repeat([[-0.57, -0.43, 0.57, 0.43]], n, axis=0),
        first=np.cumsum([0, *map(len, boxes)]).astype(np.int64),
        ray=np.ascontiguousarray(flat[:, :2] / flat[:, 2:3] + noise),
        size=np.ascontiguousarray(flat[:, 3:5] / flat[:, 2:3]),
        score=np.ascontiguousarray(flat[:, 5]),
        whole=np.ones(len(flat), bool),
        seed=np.ones(len(flat), bool),
        back=np.zeros(len(flat), bool),
    )


def standing_boxes(panels: Sequence[tuple[float, ...]], frames: int) -> Boxes:
    return [
        [(right, down, along - 8.0 * k, *rest) for right, down, along, *rest in panels]
        for k in range(frames)
    ]


@pytest.fixture
def gap_px() -> float:
    """The largest gap of a view by default."""
    return TrackSettings().gap_px


@pytest.fixture
def window() -> Callable[..., WindowCandidates]:
    """Window of boxes[frame] = (right, down, depth, width, height, score) in that camera's frame."""
    return made_window


@pytest.fixture
def standing() -> Callable[..., Boxes]:
    """Boxes of panels (right, down, along, width, height, score) that stand still, frame by frame."""
    return standing_boxes


def made_evidence_model(
    shift: float = 0.0, threshold: float = 0.0, middle: float = 0.0, **weights: float
) -> EvidenceModel:
    """Log odds `shift` plus weight times (value - middle) of each named feature, within +-100."""
    own = tuple(weights)
    assert set(own) <= set(FEATURES)
    edge = np.array([-100.0, 100.0])
    return EvidenceModel(
        features=own,
        terms=own,
        knots=(edge,) * len(own),
        curves=tuple(weights[name] * (edge - middle) for name in own),
        shift=shift,
        threshold=threshold,
        provenance="made up",
    )


@pytest.fixture(scope="session")
def evidence_model() -> Callable[..., EvidenceModel]:
    return made_evidence_model
