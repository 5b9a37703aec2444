"""Windows of candidates made of exact geometry, cameras straight ahead and 8 m apart, and models of evidence."""

import numpy as np

from wayside.schemas.models import EvidenceModel
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping.association import WindowCandidates, pair_hypotheses
from wayside.stages.mapping.landmark_evidence import FEATURES
from wayside.stages.mapping.landmark_fit import accept_greedily
from wayside.stages.mapping.window import FOLLOWED

GAP_PX = TrackSettings().gap_px


def window(boxes, noise_px=0.0):
    """Window of boxes[frame] = (right, down, depth, width, height, score) in that camera's frame."""
    n, flat = len(boxes), np.array([b for frame in boxes for b in frame], float).reshape(-1, 6)
    table = np.zeros(len(flat), FOLLOWED)
    noise = np.random.default_rng(2).normal(0, noise_px / 1400, (len(flat), 2))
    table["ray"], table["size"] = flat[:, :2] / flat[:, 2:3] + noise, flat[:, 3:5] / flat[:, 2:3]
    table["score"], table["whole"], table["seed"] = flat[:, 5], True, True
    poses = (
        np.repeat(np.eye(3)[None], n, axis=0),
        np.outer(8.0 * np.arange(n), [0, 0, 1]),
        np.full(n, 1400.0),
        np.repeat([[-0.57, -0.43, 0.57, 0.43]], n, axis=0),
    )
    first = np.cumsum([0, *map(len, boxes)]).astype(np.int64)
    return WindowCandidates.of(poses, first, table)


def fitted(candidates):
    """The landmark of the first candidate of each frame that has one."""
    frames, free = np.flatnonzero(np.diff(candidates.first)), np.zeros(len(candidates.table), bool)
    free[first := candidates.first[frames]] = True
    older, newer = range(frames[0], frames[-1]), frames[-1]
    _, found = pair_hypotheses(candidates, older, newer, GAP_PX, first[[[0, -1]]])
    return next(iter(accept_greedily(candidates, found, free, TrackSettings())), None)


def standing(panels, frames):
    """Boxes of panels (right, down, along, width, height, score) that stand still, frame by frame."""
    return [
        [(right, down, along - 8.0 * k, *rest) for right, down, along, *rest in panels]
        for k in range(frames)
    ]


def evidence_model(shift=0.0, **weights):
    """Log odds `shift` plus weight times value of each named feature, within +-100."""
    own, edge = tuple(weights), np.array([-100.0, 100.0])
    assert set(own) <= set(FEATURES)
    curves = tuple(weight * edge for weight in weights.values())
    return EvidenceModel(own, own, (edge,) * len(own), curves, shift, 0.0, "made up")
