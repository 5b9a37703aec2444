"""From the poses, odometry and transforms of a log to the pose of the camera at its images."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.pipeline.reading.contents import PoseContent
from wayside.pipeline.reading.series import Interpolated, Series
from wayside.schemas.frame import Pose
from wayside.stages.odometry import CameraPath

_LONGEST_CHAIN = 32


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
            rotation = Rotation.from_quat(value[3:7]).as_matrix()
            total = Pose(rotation, value[:3]).compose(total)
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
    """Frames from the camera up to the one that poses are of. Empty: the camera itself. None: the log does not say.

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
