import numpy as np
import pytest

from wayside.stages.mapping.association import Gates, Sightings, link
from wayside.stages.mapping.hypotheses import fit_views, metric_size, overlap_share, solve_places

GATES = Gates()
FRAMES = 6


def window(things, noise=0.0):
    """Things (right, down, along, width, height, score) seen from six cameras 8 m apart, straight ahead."""
    rng = np.random.default_rng(2)
    rays, sizes, scores = [], [], []
    for frame in range(FRAMES):
        for right, down, along, wide, tall, score in things:
            z = along - 8.0 * frame
            rays.append(np.array([right, down]) / z + rng.normal(0, noise / 1400, 2))
            sizes.append((wide / z, tall / z))
            scores.append(score)
    n = len(things)
    return Sightings(
        rotation=np.repeat(np.eye(3)[None], FRAMES, axis=0),
        centre=np.array([[0.0, 0.0, 8.0 * k] for k in range(FRAMES)]),
        focal=np.full(FRAMES, 1400.0),
        bounds=np.repeat([[-0.57, -0.43, 0.57, 0.43]], FRAMES, axis=0),
        first=np.arange(0, n * FRAMES + 1, n),
        ray=np.array(rays),
        size=np.array(sizes),
        score=np.array(scores, float),
        whole=np.ones(n * FRAMES, bool),
        leads=np.ones(n * FRAMES, bool),
    )


def solved(things, fewest=3, **kwargs):
    s = window(things, **kwargs)
    links = [link(s, a, b, GATES) for b in range(FRAMES) for a in range(max(0, b - 3), b)]
    point = np.concatenate([one.point for one in links])
    size = np.concatenate([one.size for one in links])
    free = np.ones(len(s.ray), bool)
    return s, solve_places(s, point, size, free, GATES, fewest=fewest, least_total=0.0)


def test_the_best_place_comes_first_and_each_candidate_serves_once():
    _, fits = solved([(3.5, -1.0, 60, 0.7, 0.7, 1.0), (-4, -1.0, 70, 0.7, 0.7, 3.0)])
    assert [round(f.point[2]) for f in fits] == [70, 60]
    rows = np.concatenate([f.rows for f in fits])
    assert len(np.unique(rows)) == len(rows) == 2 * FRAMES


def test_other_boxes_on_the_face_are_covered_and_propose_nothing():
    inner = (3.5, -1.0, 60, 0.55, 0.55, 0.5)
    _, fits = solved([(3.5, -1.0, 60, 0.7, 0.7, 2.0), inner])
    assert len(fits) == 1
    assert len(fits[0].covered) == FRAMES


def test_a_box_over_two_faces_gives_way_to_both_and_is_nobodys():
    plaque, shield = (3.5, -1.45, 60, 0.6, 0.3, 0.9), (3.5, -1.0, 60, 0.6, 0.6, 0.5)
    _, fits = solved([plaque, shield, (3.5, -1.15, 60, 0.6, 0.9, 1.5)])
    assert sorted(round(fit.metric[1], 2) for fit in fits) == [0.3, 0.6]
    assert sum(len(fit.covered) for fit in fits) == FRAMES


def test_a_face_is_not_shared_out_between_parts_worth_less():
    halves = [(3.5, -1.45, 60, 0.6, 0.3, -1.0), (3.5, -1.0, 60, 0.6, 0.6, -1.0)]
    _, fits = solved([*halves, (3.5, -1.15, 60, 0.6, 0.9, 3.0)])
    assert [round(fit.metric[1], 2) for fit in fits] == [0.9]


def test_noise_of_a_pixel_moves_a_place_as_its_covariance_says():
    s, (fit,) = solved([(3.5, -1.0, 60, 0.7, 0.7, 2.0)], noise=0.7)
    gap = fit.point - [3.5, -1.0, 60]
    assert gap @ np.linalg.solve(fit.covariance, gap) < 16
    assert fit.rms_px < 2
    assert overlap_share(s, fit, fit, FRAMES - 1) == (1.0, 1.0)


def test_too_few_views_make_no_place():
    _, fits = solved([(3.5, -1.0, 60, 0.7, 0.7, 2.0)], fewest=FRAMES + 1)
    assert fits == []


def test_the_size_is_the_median_of_the_nearest_whole_views():
    sizes = np.array([[0.9, 0.9], [0.7, 0.5], [0.72, 0.5], [0.3, 0.2]])
    depth = np.array([40.0, 24.0, 16.0, 8.0])
    middle, scatter = metric_size(sizes, depth, np.array([True, True, True, False]))
    assert middle == pytest.approx([0.72, 0.5])
    assert (scatter > 0).all()


def test_rays_that_hardly_meet_make_no_place():
    s = window([(3.5, -1.0, 5e6, 1e5, 1e5, 1.0)])
    assert fit_views(s, np.arange(FRAMES), np.arange(FRAMES), nearest=2) is None
