"""Whether images show the places that their order says, or all the same place.

Of two images of a vehicle that goes forward, the later one was taken further ahead: what both show moves outward, away
from the epipole. Corners are searched outward alone, so an order is tested by counting those that have moved, and its
reverse by counting them with the images exchanged. No length of a step takes part.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import nan
from typing import NamedTuple

import numpy as np

from wayside.schemas.frame import Frame
from wayside.schemas.settings import MotionSettings, TieSettings
from wayside.stages.odometry.descriptor_matching import match_in_bands
from wayside.stages.odometry.motion_prior import predict_motion
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.relative_pose import RelativePose
from wayside.stages.odometry.tie_points import KeypointImage
from wayside.stages.odometry.visual_odometry import VisualOdometry


class View(NamedTuple):
    """An image at its place in the drive."""

    frame: Frame
    image: KeypointImage


@dataclass(slots=True)
class ImageOrder:
    """Compares images by pairs, each pair once; odometry: its state before the doubtful step."""

    odometry: VisualOdometry
    _moved: dict[tuple[int, int], int] = field(default_factory=dict)

    def misplaced(self, past: Sequence[View], ahead: Iterable[View], *, certain: bool) -> set[int]:
        """Indices of the frames that show another place, empty where that is not certain.

        Images contradict each other where the reverse of their order is found. The fewest are left out that leave no
        contradiction; where any of several would do, as of two neighbours that are exchanged, all of them. An image
        that was taken far away contradicts none, but those beside it agree with each other better than with it.
        Nothing is left out where the drive does not go on behind it.

        Parameters
        ----------
        past, ahead
            Images before and from the doubtful step on, in order.
        certain
            Whether the newest of `past` is right, as those before it are.
        """
        coming = list(ahead)
        if not self._agree(coming[0], past[-1]):
            return {coming[0].frame.index} if self._is_foreign(past[-1], *coming[:2]) else set()
        reach = self.odometry.settings.order_reach
        past = past[-reach:]
        views, sure = [*past, *coming], len(past) - (not certain)
        against = self._contradictions(views)
        left_out: set[int] = set()
        while counts := {i: len(others - left_out) for i, others in against.items()}:
            free = {i: n for i, n in counts.items() if i not in left_out and i >= sure and n}
            if not free:
                break
            # An image that is right decides; else the one that most others contradict is wrong.
            wrong = {i for i in free if any(other < sure for other in against[i])}
            left_out |= wrong or {i for i, n in free.items() if n == max(free.values())}
        if not left_out or not self._goes_on(views, left_out, first_coming=len(past)):
            return set()
        return {views[i].frame.index for i in left_out}

    def _contradictions(self, views: Sequence[View]) -> dict[int, set[int]]:
        against: dict[int, set[int]] = {i: set() for i in range(len(views))}
        for i in range(len(views)):
            for k in range(i + 1, min(i + 1 + self.odometry.settings.order_reach, len(views))):
                if self._agree(views[k], views[i]):
                    against[i].add(k)
                    against[k].add(i)
        return against

    def _agree(self, first: View, second: View) -> bool:
        """Whether two images were surely taken in this order."""
        return self._is_clear(self._moves(first, second), self._moves(second, first))

    def _goes_on(self, views: Sequence[View], left_out: set[int], *, first_coming: int) -> bool:
        """Whether the drive goes forward behind those left out: else it is the vehicle that turns back.

        The first image behind them agrees with the one before them, or with the next. At the end of a drive nothing is
        behind them: then the last two before them have to agree.
        """
        kept = [i for i in range(len(views)) if i not in left_out]
        behind = sum(i < min(left_out) for i in kept)
        if behind == len(kept) and len(views) - first_coming <= self.odometry.settings.order_reach:
            behind -= 1
        around = [i for i in (behind - 1, behind, behind + 1) if 0 <= i < len(kept)]
        if behind >= len(kept):
            return False
        return any(self._agree(views[kept[i]], views[kept[k]]) for i, k in pairwise(around))

    def _is_foreign(self, before: View, one: View, *behind: View) -> bool:
        """Whether the images on either side of one with no fewer corners agree with each other better than with it."""
        if not behind:
            return False
        around = before, behind[0]
        corners = [len(view.image.corners) for view in around]
        if len(one.image.corners) * self.odometry.settings.order_ratio < min(corners):
            return False  # blurred or dark: it may well be of its place
        across = self._moves(*around)
        return all(
            self._is_clear(across, self._moves(*pair)) for pair in ((before, one), (one, behind[0]))
        )

    def _is_clear(self, count: int, other: int) -> bool:
        s = self.odometry.settings
        return count >= s.smallest_ties and count >= s.order_ratio * other

    def _moves(self, first: View, second: View) -> int:
        """Corners that move outward from one image to another, if that was the order, whatever it is in the drive.

        None where the prior says that the vehicle went backwards.
        """
        pair = first.frame.index, second.frame.index
        if pair not in self._moved:
            before, after = sorted((first.frame, second.frame), key=lambda frame: frame.index)
            # Only the direction matters: any length will do where poses do not tell it.
            after = replace(after, spacing_m=after.spacing_m or 1.0)
            odometry, travel = self.odometry, self.odometry.mount.travel
            settings, rotation = odometry.settings, odometry.last.rotation
            expected = predict_motion(before, after, travel, rotation, nan, settings)
            self._moved[pair] = 0
            if expected.straight[1] @ travel.direction > 0:
                pose = odometry.estimate(
                    first.image,
                    second.image,
                    expected,
                    Mount(settings),
                    settings.smallest_ties,
                    replace(odometry.ties, inlier_ratio=0.0),
                )
                if pose is not None:
                    self._moved[pair] = self._moved_outward(pose, second.image.focal_px)
        return self._moved[pair]

    def _moved_outward(self, pose: RelativePose, focal_px: float) -> int:
        solid = np.column_stack([pose.previous, np.ones(len(pose.previous))]) @ pose.rotation
        toward = pose.rotation.T @ pose.direction
        far = solid[:, :2] / solid[:, 2:]
        outward = far - toward[:2] / toward[2]
        reach = np.maximum(np.linalg.norm(outward, axis=1), 1e-9)
        moved = focal_px * np.einsum("nk,nk->n", pose.current - far, outward) / reach
        return int((pose.inlier & (moved > self.odometry.settings.smallest_parallax_px)).sum())


def shows_no_motion(
    before: KeypointImage | None,
    now: KeypointImage | None,
    settings: MotionSettings,
    ties: TieSettings,
) -> bool:
    """Whether so many corners of an image are found again at the same place that the camera cannot have moved.

    This needs no prior: a wrong pose or spacing does not hide a copy. Travel moves most corners, and leaves only those
    that are far away, or on the vehicle itself; corners on other vehicles move while the camera stands. False where an
    image has too few corners to tell.
    """
    if before is None or now is None or before.grey.shape != now.grey.shape:
        return False
    most = min(len(before.corners), len(now.corners))
    if most < settings.smallest_ties:
        return False
    place = before.corners.astype(np.float64)
    here = np.column_stack([place, np.tile([1.0, 0.0, 0.0, ties.search_px], (len(place), 1))])
    again = match_in_bands(
        here,
        before.descriptors,
        now.corners.astype(np.float64),
        now.descriptors,
        farthest=ties.coarse_bits,
        ratio=ties.guided_ratio,
        same_corner_px=ties.same_corner_px,
    )
    return len(again) >= settings.standing_share * most
