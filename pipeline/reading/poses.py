"""From the poses, odometry and transforms of a log to the pose of the camera at a time."""

from __future__ import annotations

import math

import numpy as np

from wayside.pipeline.reading.contents import PoseContent
from wayside.pipeline.reading.series import TimeSeries, blend_poses, unit
from wayside.schemas.frame import Pose, PosePrior
from wayside.schemas.settings import ReadSettings

LOOKING_AHEAD = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
"""Optical frame in a vehicle frame (x forward, y left, z up; ROS REP 103 and 105) for a camera of unknown mount."""

_STILL_M, _STILL_RAD = 1e-6, 1e-6
_LONGEST_CHAIN = 32


def to_pose(content: PoseContent) -> Pose:
    """Pose with a rotation matrix, from a quaternion of any length."""
    x, y, z, w = unit(content.rotation)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return Pose(rotation, np.array(content.translation, np.float64))


class Edge:
    """A frame in its parent over time: fixed until it is seen to move."""

    def __init__(self, first: PoseContent) -> None:
        self.parent, self.first = bare(first.parent), first
        self.moves = False
        self.series: TimeSeries[PoseContent] = TimeSeries()

    def add(self, time_ns: int, content: PoseContent) -> None:
        """A further sample."""
        self.parent = bare(content.parent)
        self.moves = self.moves or _differ(self.first, content)
        self.series.add(time_ns, content)

    def at(self, time_ns: int, settings: ReadSettings) -> Pose | None:
        """Pose at a time; of a fixed edge, its one pose at any time."""
        content = self.series.at(time_ns, blend_poses, settings) if self.moves else self.first
        return None if content is None else to_pose(content)


class TransformTree:
    """All transforms of a log: each child frame in its parent."""

    def __init__(self) -> None:
        self.edges: dict[str, Edge] = {}

    def add(self, time_ns: int, content: PoseContent) -> None:
        """Take in a transform; one that names no frames, or a frame as its own parent, is ignored."""
        child = bare(content.child)
        if not child or child == bare(content.parent):
            return
        if child not in self.edges:
            self.edges[child] = Edge(content)
        self.edges[child].add(time_ns, content)

    def forget_samples(self) -> None:
        """Keep what is fixed and which frames move, not where they were at which time."""
        for edge in self.edges.values():
            edge.series = TimeSeries()

    def chain(self, frame: str, until: str | None = None) -> list[Edge]:
        """Edges from a frame up to the root, or up to `until` (empty where that is not on the way)."""
        chain: list[Edge] = []
        name = bare(frame)
        while name != until and name in self.edges and len(chain) < _LONGEST_CHAIN:
            chain.append(self.edges[name])
            name = chain[-1].parent
        return chain if until is None or name == until else []

    def root(self, frame: str) -> str:
        """Topmost frame above this one; itself where nothing is known of it."""
        chain = self.chain(frame)
        return chain[-1].parent if chain else bare(frame)

    def moves(self, frame: str) -> bool:
        """Whether the frame is seen to move in its root."""
        return any(edge.moves for edge in self.chain(frame))


def compose(chain: list[Edge], time_ns: int, settings: ReadSettings) -> Pose | None:
    """Pose of the chain's first frame in its last parent; None where an edge is unknown at that time."""
    total: Pose | None = None
    for edge in chain:
        pose = edge.at(time_ns, settings)
        if pose is None:
            return None
        total = pose if total is None else pose.compose(total)
    return total


class CameraPoses:
    """Pose of the camera over time, from one source chosen beforehand.

    Parameters
    ----------
    camera_frame
        `frame_id` of the images, may be empty.
    source
        "transforms", "poses" or "odometry".
    settings
        Between which samples poses are interpolated.

    Notes
    -----
    A pose that names no child is the camera's own, unless transforms mount the camera on a body: then it is that
    body's. Odometry of a child other than the camera goes through the mount; where there is none, the camera is
    taken to look straight ahead from a vehicle frame.
    """

    def __init__(self, camera_frame: str, source: str, settings: ReadSettings) -> None:
        self.settings = settings
        self.camera_frame, self.source = bare(camera_frame), source
        self.tree = TransformTree()
        self.series: TimeSeries[PoseContent] = TimeSeries()
        self.assumed_mount = False

    def add(self, time_ns: int, content: PoseContent) -> None:
        """Take in a pose or odometry of the source."""
        self.series.add(time_ns, content)

    def reaches(self, time_ns: int) -> bool:
        """Whether everything needed for a pose at this time has come."""
        if self.source != "transforms":
            return self.series.reaches(time_ns)
        moving = [edge for edge in self.tree.chain(self.camera_frame) if edge.moves]
        return bool(moving) and all(edge.series.reaches(time_ns) for edge in moving)

    def at(self, time_ns: int) -> PosePrior | None:
        """The camera's pose at a time, None where the log does not tell."""
        if self.source == "transforms":
            pose = compose(self.tree.chain(self.camera_frame), time_ns, self.settings)
            return None if pose is None else PosePrior(pose, None, None, "poses")
        content = self.series.at(time_ns, blend_poses, self.settings)
        if content is None:
            return None
        mount = self._mount(content, time_ns)
        pose = to_pose(content)
        whole = pose if mount is None else pose.compose(mount)
        return PosePrior(whole, content.sigma_m, content.sigma_rad, self.source)

    def _mount(self, content: PoseContent, time_ns: int) -> Pose | None:
        """The camera in the frame that the pose is of; None where that is the camera."""
        child, parent = bare(content.child), bare(content.parent)
        chain = self.tree.chain(self.camera_frame)
        if not child:
            body = self.tree.root(self.camera_frame)
            above = {self.camera_frame, *(edge.parent for edge in chain)}
            return (
                compose(chain, time_ns, self.settings)
                if chain and body != parent and parent not in above
                else None
            )
        if child == self.camera_frame or "optical" in child:
            return None
        if on_the_way := self.tree.chain(self.camera_frame, child):
            return compose(on_the_way, time_ns, self.settings)
        self.assumed_mount = True
        return LOOKING_AHEAD


def bare(frame: str) -> str:
    """A frame's name without the leading slash of older recordings."""
    return frame.lstrip("/")


def _differ(first: PoseContent, second: PoseContent) -> bool:
    shift = math.dist(first.translation, second.translation)
    a, b = unit(first.rotation), unit(second.rotation)
    turn = 1.0 - abs(sum(p * q for p, q in zip(a, b, strict=True)))
    return shift > _STILL_M or turn > _STILL_RAD
