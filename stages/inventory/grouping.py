"""Sightings to panels, panels to supports."""

from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, triu
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from wayside.schemas.settings.merging import MergeSettings
from wayside.schemas.sightings import Floats, Ints, MergedPanels, Sightings
from wayside.stages.inventory.association import (
    MISREAD,
    PLACE_TERM,
    TAIL_FREEDOM,
    YEAR_NS,
    candidate_pairs,
    changed_share,
    face_log_ratio,
    faces_log_ratio,
    miss_log_ratio,
    place_log_ratio,
    size_log_ratio,
)
from wayside.stages.inventory.offsets import relative_variance, solve_offsets
from wayside.stages.kernels import compiled


def merge_sightings(sightings: Sightings, settings: MergeSettings) -> MergedPanels:
    """The panels and supports of an area.

    First the offsets between the drives are taken out. A place gathers at most one sighting of each drive. Pairs join
    groups in order of their log-likelihood ratio (place and face), unless both hold a sighting of one drive, or the
    groups' positions are more likely two panels. Faces at a place follow each other in time: a face that differs for
    good is another panel (`face_runs`).

    A panel's position is the mean of its corrected sightings by the inverse of their covariances. Its covariance
    describes the mean of the drives that saw it, with the whole common error of each. Relative offsets are known well.
    Their common level is known only as well as the mean of the fixes.
    """
    offset, known = solve_offsets(sightings, settings)
    corrected = sightings.position - offset
    pairs = candidate_pairs(sightings, settings, corrected)
    relative = relative_variance(sightings, known, pairs)
    place = _places(sightings, corrected, pairs, relative, settings)
    panel = face_runs(sightings, place, settings)
    position, covariance = combine(sightings, corrected, panel)
    first = np.unique(panel, return_index=True)[1]
    support = _supports(sightings, panel, position, settings.support_m)
    return MergedPanels(offset, panel, position, covariance, support, place[first])


def combine(sightings: Sightings, corrected: Floats, panel: Ints) -> tuple[Floats, Floats]:
    """Position (p, 3) and covariance (p, 3, 3) of panels, from positions (n, 3) whose offsets are taken out."""
    count = int(panel.max()) + 1
    information = np.linalg.inv(sightings.covariance)
    total, weighted, honest = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3, 3))
    np.add.at(total, panel, information)
    np.add.at(weighted, panel, np.einsum("nij,nj->ni", information, corrected))
    common = np.eye(3) * np.square(sightings.common_sigma_m)[:, None, [0, 0, 1]]
    np.add.at(honest, panel, np.linalg.inv(sightings.covariance + common))
    position = np.linalg.solve(total, weighted[..., None])[..., 0]
    return np.asarray(position, np.float64), np.asarray(np.linalg.inv(honest), np.float64)


def _places(
    sightings: Sightings, corrected: Floats, pairs: Ints, relative: Floats, settings: MergeSettings
) -> Ints:
    """Number of the place of each sighting; pairs (m, 2) with the variance (m, 2) of the drives' relative offset."""
    i, j = pairs.T
    shared = np.eye(3) * relative[:, None, [0, 0, 1]]
    spread = sightings.covariance[i] + sightings.covariance[j] + shared
    face = faces_log_ratio(sightings, i, j, settings) + miss_log_ratio(sightings, i, j, settings)
    score = face + place_log_ratio(corrected[i] - corrected[j], spread)
    order = np.lexsort((j, i, -score))
    order = order[score[order] > 0]
    information = np.asarray(np.linalg.inv(sightings.covariance), np.float64)
    weighted = np.einsum("nij,nj->ni", information, corrected)
    kept = pairs[order], relative[order], face[order]
    group = _join(*kept, sightings.drive, weighted, information)
    return np.asarray(np.unique(group, return_inverse=True)[1], np.int64)


@compiled
def _join(
    pairs: Ints,
    relative: Floats,
    face: Floats,
    drive: Ints,
    weighted: Floats,
    information: Floats,
) -> Ints:
    """Group of each of n rows, named by its lowest row; no group holds two rows of one drive.

    `pairs` (m, 2): rows to join, best first. `relative` (m, 2): variance of the drives' relative offset, level and up.
    `face` (m,): log-likelihood ratio of the faces. `information` (n, 3, 3), `weighted` (n, 3): of the rows, and this
    times the position; overwritten by the sums of the groups.
    """
    group, following = np.arange(len(drive)), np.full(len(drive), -1)  # members are linked lists
    for k in range(len(pairs)):
        a, b = np.sort(group[pairs[k]])
        if a == b:
            continue
        shared, last, one = False, a, a
        while one >= 0:
            other = b
            while other >= 0:
                shared |= drive[one] == drive[other]
                other = following[other]
            last, one = one, following[one]
        if shared:
            continue
        spread = np.linalg.inv(information[a]) + np.linalg.inv(information[b])
        for axis in range(3):
            spread[axis, axis] += relative[k, axis // 2]
        ours = np.linalg.solve(information[a], weighted[a])
        apart = ours - np.linalg.solve(information[b], weighted[b])
        distance2 = np.dot(apart, np.linalg.solve(spread, apart))
        tail = (TAIL_FREEDOM + 3) * np.log1p(distance2 / TAIL_FREEDOM)
        # the place as in `place_log_ratio`
        if face[k] + PLACE_TERM - 0.5 * (np.log(np.linalg.det(spread)) + tail) <= 0:
            continue
        following[last] = b
        one = b
        while one >= 0:
            group[one] = a
            one = following[one]
        information[a] += information[b]
        weighted[a] += weighted[b]
    return group


def face_runs(sightings: Sightings, place: Ints, settings: MergeSettings) -> Ints:
    """Number of the panel (n,) of each sighting: at each place, runs in time of one face.

    The most probable sequence of faces (Viterbi 1967). A drive misreads a face with one probability, and a face is
    replaced with a probability per year. A face that differs once among others of the same month is a misreading. A
    face that differs from then on is another panel. Panels are numbered by place, then time.
    """
    order = np.lexsort((sightings.drive, sightings.time_ns, place))
    run = np.zeros(len(place), np.int64)
    differ = _differ(sightings, place)
    for rows in np.split(order, np.flatnonzero(np.diff(place[order])) + 1):
        if differ[place[rows[0]]]:
            run[rows] = _viterbi(sightings, rows, settings)
    new = np.ones(len(place), bool)
    new[1:] = (np.diff(place[order]) != 0) | (np.diff(run[order]) != 0)
    panel = np.empty(len(place), np.int64)
    panel[order] = np.cumsum(new) - 1
    return panel


def _differ(sightings: Sightings, place: Ints) -> NDArray[np.bool_]:
    """Whether colours, shapes, codes or sizes at each place are not all alike; places are numbered without gaps."""
    count = int(place.max()) + 1
    differ = np.zeros(count, bool)
    for code in (sightings.color, sightings.shape, sightings.code):
        known = np.flatnonzero(code >= 0)
        any_code = np.zeros(count, np.int64)
        any_code[place[known]] = code[known]
        differ[place[known[code[known] != any_code[place[known]]]]] = True
    first, sized = np.zeros(count, np.int64), np.isfinite(sightings.size_m).all(axis=1)
    known = np.flatnonzero(sized)[::-1]
    first[place[known]] = known  # of several the last written stays, the first in order
    ratio = size_log_ratio(sightings, np.arange(len(place)), first[place])
    differ[place[ratio < -1]] = True
    return differ


def _viterbi(sightings: Sightings, rows: Ints, settings: MergeSettings) -> Ints:
    """Number of the run of each row, in order of time. The possible faces are those that the rows have."""
    count = len(rows)
    seen, face = (side.ravel() for side in np.meshgrid(rows, rows, indexing="ij"))
    fit = face_log_ratio(sightings, seen, face, log(1 - MISREAD), log(MISREAD))
    fit = fit.reshape(count, count)
    changes = changed_share(np.diff(sightings.time_ns[rows]) / YEAR_NS, settings)
    best, back = fit[0], np.zeros((count, count), np.int64)
    for k in range(1, count):
        changed = max(float(changes[k - 1]), 1e-9)
        stay, move = log(1 - changed), log(changed / max(count - 1, 1))
        total = best[:, None] + np.where(np.eye(count, dtype=bool), stay, move)
        back[k] = total.argmax(axis=0)
        best = total.max(axis=0) + fit[k]
    face_of = np.empty(count, np.int64)
    face_of[-1] = best.argmax()
    for k in range(count - 1, 0, -1):
        face_of[k - 1] = back[k, face_of[k]]
    return np.cumsum(np.concatenate([[0], np.diff(face_of) != 0]))


def _supports(sightings: Sightings, panel: Ints, position: Floats, near_m: float) -> Ints:
    """Support (p,) of each panel: one place on the ground, or one assembly in most of the drives that saw both."""
    count = len(position)
    key = np.stack([sightings.drive, sightings.assembly], axis=1)
    _, assembly = np.unique(key, axis=0, return_inverse=True)
    votes = triu(_in_common(panel, assembly.ravel()), 1, "coo")
    voters = _in_common(panel, sightings.drive)[votes.row, votes.col]
    same = np.stack([votes.row, votes.col], axis=1)[2 * votes.data > voters]
    near = cKDTree(position[:, :2]).query_pairs(near_m, output_type="ndarray")
    a, b = np.concatenate([same, near]).T
    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _in_common(panel: Ints, group: Ints) -> csr_array:
    """How many groups two panels have in common, (p, p); panel and group (n,) of each sighting."""
    member = csr_array((np.ones(len(panel), np.int64), (panel, group)))
    return csr_array(member @ member.T)
