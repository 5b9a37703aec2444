"""Positions and transforms of a log as arrays: as recorded, without impossible ones, and at the images."""

from array import array
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.pipeline.reading.clocks import Flags, Floats, Integers, StreamTimes, stream_times
from wayside.pipeline.reading.contents import FixContent, PoseContent
from wayside.pipeline.reading.layout import Channel
from wayside.schemas.frame import EARTH_RADIUS_M, Pose
from wayside.stages.geometry import median_longitude_deg, turn_deg
from wayside.stages.odometry import CameraPath

WIDEST_GAP_S = 5.0
"""Nothing is interpolated across a longer silence: a vehicle may turn meanwhile."""
_CARRIED_S, _CARRIED_GAPS = 0.1, 10.0
"""The last motion is carried on so far, and by so many gaps at most: its errors grow by as much."""
_FASTEST_MPS, _SLACK_M = 150.0, 10.0
"""Vehicles on a road are slower; fixes scatter by metres within a tenth of a second."""
_HARDEST_MPS2, _SPIKE_M, _SPIKE_SCATTERS = 15.0, 0.5, 6.0
"""Emergency braking reaches 10 m/s2; smaller spikes are weighted down when the path is smoothed."""
_LOOK_BACK = 256
"""Parts of a series before each that it may continue: bounds the time of a series that is nothing but jumps."""
_LONGEST_CHAIN = 32


@dataclass(slots=True)
class Series:
    """What is kept of the messages of one stream, in file order.

    `header_ns`: 0 where not set. `offset`, `channels`: of images, where message or chunk begin in the log, and what it
    came on. `value`: of positions ten numbers a message, nan where not stated. Three are the position, metres (of a fix
    latitude and longitude, degrees, and height). Four are the quaternion x, y, z, w. Three are standard deviations: a
    pose has one of position (m) and one of rotation (rad), a fix those of east, north and up.
    """

    log_ns: "array[int]" = field(default_factory=lambda: array("q"))
    header_ns: "array[int]" = field(default_factory=lambda: array("q"))
    offset: "array[int]" = field(default_factory=lambda: array("q"))
    channels: list[Channel] = field(default_factory=list)
    value: "array[float]" = field(default_factory=lambda: array("d"))
    first: PoseContent | FixContent | None = None

    def stamp(self, log_ns: int, header_ns: int | None) -> None:
        """Take in the times of a message."""
        self.log_ns.append(log_ns)
        self.header_ns.append(header_ns or 0)

    def add(self, log_ns: int, content: PoseContent | FixContent) -> None:
        """Take in a position."""
        self.first = self.first or content
        self.stamp(log_ns, content.time_ns)
        if isinstance(content, PoseContent):
            self.value.extend((*content.translation, *content.rotation))
            stated = (content.sigma_m, content.sigma_rad, None)
            self.value.extend(np.nan if one is None else one for one in stated)
        else:
            fix = content.fix
            self.value.extend((fix.latitude_deg, fix.longitude_deg, fix.altitude_m, 0, 0, 0, 1))
            self.value.extend(fix.sigma_m or (np.nan,) * 3)

    def times(self) -> StreamTimes:
        """The times, judged."""
        return stream_times(np.array(self.log_ns, np.int64), np.array(self.header_ns, np.int64))

    def values(self) -> Floats:
        """(n, 10) values, quaternions of length one."""
        value = np.array(self.value, np.float64).reshape(-1, 10)
        value[:, 3:7] /= np.linalg.norm(value[:, 3:7], axis=1, keepdims=True)
        return value

    @property
    def moves(self) -> bool:
        """Whether the values change by more than rounding."""
        value = self.values()
        turn = 1 - np.abs(value[:, 3:7] @ value[0, 3:7]) if len(value) else np.zeros(0)
        return bool((np.ptp(value[:, :3], axis=0) > 1e-6).any() or (turn > 1e-6).any())


class Samples(NamedTuple):
    """Positions sorted by time, one at a time: time_ns (n,), value (n, 10) as in `Series`."""

    time_ns: Integers
    value: Floats

    @staticmethod
    def sorted(time_ns: Integers, value: Floats) -> "Samples":
        """By time; of several at one time the last."""
        order = np.argsort(time_ns, kind="stable")
        time = time_ns[order]
        order = order[np.append(time[1:] != time[:-1], True)] if len(time) else order
        return Samples(time_ns[order], value[order])

    def kept(self, rows: Flags) -> "Samples":
        """These rows alone."""
        return Samples(self.time_ns[rows], self.value[rows])


class Interpolated(NamedTuple):
    """A series at the times of images.

    `known`: (k,) whether there are samples near enough. `value`: (k, 10) as of `Samples`, standard deviations of the
    nearer one; nan where not known. `span_s`: (k,) time between the samples on both sides, 0 at a sample.
    """

    known: Flags
    value: Floats
    span_s: Floats


def interpolate(samples: Samples, time_ns: Integers) -> Interpolated:
    """Positions linear, longitudes the short way round, quaternions by slerp (Shoemake 1985)."""
    n, k = len(samples.time_ns), len(time_ns)
    value = np.full((k, 10), np.nan)
    if not n or not k:
        return Interpolated(np.zeros(k, np.bool_), value, np.zeros(k))
    place = np.searchsorted(samples.time_ns, time_ns)
    exact = samples.time_ns[place.clip(max=n - 1)] == time_ns
    before = np.where(exact, place, place - 1).clip(0, max(n - 2, 0))
    after = np.minimum(before + 1, n - 1)
    first, second = samples.time_ns[before], samples.time_ns[after]
    gap = (second - first) * 1e-9
    outside = np.maximum(first - time_ns, time_ns - second) * 1e-9
    farthest = np.minimum(_CARRIED_S, _CARRIED_GAPS * gap)
    known = exact | ((gap > 0) & (gap <= WIDEST_GAP_S) & (outside <= farthest))
    part = np.where(gap > 0, (time_ns - first) * 1e-9 / np.where(gap > 0, gap, 1.0), 0.0)
    part = np.where(exact & (before == place), 0.0, part)
    a, b = samples.value[before], samples.value[after]
    value[:, :3] = a[:, :3] + (b[:, :3] - a[:, :3]) * part[:, None]
    start, end = Rotation.from_quat(a[:, 3:7]), Rotation.from_quat(b[:, 3:7])
    turn = Rotation.from_rotvec((start.inv() * end).as_rotvec() * part[:, None])
    value[:, 3:7] = (start * turn).as_quat()
    value[:, 7:] = np.where(part[:, None] < 0.5, a[:, 7:], b[:, 7:])
    value[~known] = np.nan
    return Interpolated(known, value, np.where(exact, 0.0, gap))


def continuous_longitudes(samples: Samples) -> Samples:
    """Fixes with longitudes that go on across 180 degrees, so that they can be interpolated."""
    value = samples.value.copy()
    if len(value):
        middle = median_longitude_deg(value[:, 1])
        value[:, 1] = middle + turn_deg(middle, value[:, 1])
    return Samples(samples.time_ns, value)


def metres(degrees: Floats) -> Floats:
    """East, north, up (n, 3) on a sphere about the median, of latitudes, continuous longitudes and heights (n, 3)."""
    if not len(degrees):
        return degrees
    latitude, longitude = np.median(degrees[:, :2], axis=0)
    scale = np.radians(1.0) * EARTH_RADIUS_M
    east = (degrees[:, 1] - longitude) * scale * np.cos(np.radians(latitude))
    return np.stack([east, (degrees[:, 0] - latitude) * scale, degrees[:, 2]], axis=1)


def possible(time_ns: Integers, position: Floats) -> Flags:
    """Which positions (n, 3) of a series, in the order of time, a vehicle can have been at.

    The longest part whose positions can be reached from each other is kept; of it, no position lies aside of the path
    of all its neighbours.
    """
    kept = np.zeros(len(time_ns), np.bool_)
    time_s = np.asarray((time_ns - time_ns[:1]) * 1e-9, np.float64)
    rows = _reachable(time_s, position)
    rows = rows[~_aside(time_s[rows], position[rows])]
    kept[rows] = True
    return kept


def _reachable(time_s: Floats, position: Floats) -> Integers:
    """The most rows of which each can be reached from the one before at a vehicle's speed."""

    def can_go(a: Integers, b: Integers) -> Flags:
        length = np.linalg.norm(position[b] - position[a], axis=-1)
        return np.asarray(length <= _FASTEST_MPS * (time_s[b] - time_s[a]) + _SLACK_M)

    rows = np.arange(len(time_s))
    parts = np.split(rows, np.flatnonzero(~can_go(rows[:-1], rows[1:])) + 1)
    size, before = np.array([len(part) for part in parts]), np.full(len(parts), -1)
    last = np.array([part[-1] for part in parts]) if len(rows) else rows
    for k in range(1, len(parts)):
        earlier = np.arange(max(0, k - _LOOK_BACK), k)
        fits = earlier[can_go(last[earlier], np.full(len(earlier), parts[k][0]))]
        if len(fits):
            before[k] = fits[np.argmax(size[fits])]
            size[k] += size[before[k]]
    chosen, k = [rows[:0]], int(np.argmax(size))
    while k >= 0:
        chosen.append(parts[k])
        k = int(before[k])
    return np.concatenate(chosen[::-1])


def _aside(time_s: Floats, position: Floats) -> Flags:
    """Positions that lie far from the lines between each two of the neighbours before and behind them."""
    aside = np.zeros(len(time_s), np.bool_)
    if len(time_s) < 5:
        return aside
    here = np.arange(2, len(time_s) - 2)
    nearest, sagitta = np.full(len(here), np.inf), np.zeros(len(here))
    for a in (here - 2, here - 1):
        for b in (here + 1, here + 2):
            span = np.maximum(time_s[b] - time_s[a], 1e-9)
            part = ((time_s[here] - time_s[a]) / span)[:, None]
            off = position[here] - position[a] - (position[b] - position[a]) * part
            nearest = np.minimum(nearest, np.linalg.norm(off, axis=1))
            bend = (time_s[here] - time_s[a]) * (time_s[b] - time_s[here]) / 2
            sagitta = np.maximum(sagitta, _HARDEST_MPS2 * bend)
    scatter = 1.48 * float(np.median(nearest))
    aside[here] = nearest > _SPIKE_M + sagitta + _SPIKE_SCATTERS * scatter
    return aside


@dataclass(slots=True)
class TransformTree:
    """All transforms of a log: each child frame in its parent."""

    edges: dict[str, Series] = field(default_factory=dict)

    def add(self, log_ns: int, content: PoseContent) -> None:
        """Take in a transform; one that names no frames, or a frame as its own parent, is ignored."""
        child = bare(content.child)
        if child and child != bare(content.parent):
            self.edges.setdefault(child, Series()).add(log_ns, content)

    def parent(self, frame: str) -> str:
        """The frame that this one, which is known, is given in."""
        return bare(_names(self.edges[frame])[0])

    def chain(self, frame: str, until: str | None = None) -> list[str]:
        """Frames from one up to below the root, or below `until`; empty where that is not on the way."""
        chain: list[str] = []
        name = bare(frame)
        while name in self.edges and name != until and len(chain) < _LONGEST_CHAIN:
            chain.append(name)
            name = self.parent(name)
        return chain if until in (None, name) else []

    def root(self, frame: str) -> str:
        """Topmost frame above this one; itself where nothing is known of it."""
        chain = self.chain(frame)
        return self.parent(chain[-1]) if chain else bare(frame)

    def moving(self, frame: str) -> list[str]:
        """Frames from this one to the root that are seen to move in their parents."""
        return [name for name in self.chain(frame) if self.edges[name].moves]

    def mount(self, chain: list[str]) -> Pose | None:
        """The first frame of a chain in the parent of the last, where nothing in it moves; None elsewhere."""
        total = Pose(np.eye(3), np.zeros(3))
        for name in chain:
            edge = self.edges[name]
            if edge.moves:
                return None
            value = edge.values()[0]
            total = Pose(Rotation.from_quat(value[3:7]).as_matrix(), value[:3]).compose(total)
        return total


def _names(positions: Series) -> tuple[str, str]:
    """Parent and child of a stream of poses; both may be empty."""
    first = positions.first
    return (first.parent, first.child) if isinstance(first, PoseContent) else ("", "")


def path_of(found: Interpolated) -> CameraPath:
    """Poses at the times of images as a path."""
    rotation = np.tile(np.eye(3), (len(found.known), 1, 1))
    if found.known.any():
        rotation[found.known] = Rotation.from_quat(found.value[found.known, 3:7]).as_matrix()
    return CameraPath(found.known, rotation, found.value[:, :3])


def composed(outer: CameraPath, inner: CameraPath) -> CameraPath:
    """Frames given in the frames of `outer`, in the world of these."""
    centre = np.einsum("kij,kj->ki", outer.rotation, inner.centre) + outer.centre
    return CameraPath(outer.known & inner.known, outer.rotation @ inner.rotation, centre)


def fixed(pose: Pose, count: int) -> CameraPath:
    """One pose at all of `count` images."""
    rotation, centre = np.tile(pose.rotation, (count, 1, 1)), np.tile(pose.centre, (count, 1))
    return CameraPath(np.ones(count, np.bool_), rotation, centre)


def mount_of(tree: TransformTree, positions: Series, camera_frame: str) -> list[str] | None:
    """Frames from the camera up to the one that the poses describe. Empty: the camera itself. None: not stated.

    A pose that names no child is the camera's own, unless transforms mount the camera on a body: then it is that
    body's.
    """
    camera = bare(camera_frame)
    parent, child = map(bare, _names(positions))
    if not child:
        chain = tree.chain(camera)
        above = {camera, *(tree.parent(name) for name in chain)}
        return [] if parent in above else chain
    if child == camera or "optical" in child:
        return []
    return tree.chain(camera, child) or None


def bare(frame: str) -> str:
    """A frame's name without the leading slash of older recordings."""
    return frame.lstrip("/")
