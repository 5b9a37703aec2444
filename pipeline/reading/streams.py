"""What one pass over a log keeps of its messages: times and values as arrays, and where the images stand."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field, replace

import numpy as np

from wayside.pipeline.reading.clocks import Floats, Integers, StreamTimes, stream_times
from wayside.pipeline.reading.contents import CalibrationContent, FixContent, PoseContent


def _integers() -> array[int]:
    return array("q")


def _floats() -> array[float]:
    return array("d")


@dataclass(slots=True)
class Times:
    """Log and header time of each message of a stream, in file order; header 0 where not set."""

    log_ns: array[int] = field(default_factory=_integers)
    header_ns: array[int] = field(default_factory=_integers)

    def stamp(self, log_ns: int, header_ns: int | None) -> None:
        """Take in the times of a message."""
        self.log_ns.append(log_ns)
        self.header_ns.append(header_ns or 0)

    def times(self) -> StreamTimes:
        """The times, judged."""
        return stream_times(np.array(self.log_ns, np.int64), np.array(self.header_ns, np.int64))


@dataclass(slots=True)
class ImageIndex(Times):
    """The images of one topic: where each message or its chunk begins in the file."""

    offset: array[int] = field(default_factory=_integers)


@dataclass(slots=True)
class CameraTrack(Times):
    """The calibrations of one topic: `contents` holds each once, `row` says which one a message states."""

    row: array[int] = field(default_factory=_integers)
    contents: list[CalibrationContent] = field(default_factory=list)

    def add(self, log_ns: int, content: CalibrationContent) -> None:
        """Take in a calibration that can be used."""
        untimed = replace(content, time_ns=None)
        if untimed not in self.contents:
            self.contents.append(untimed)
        self.stamp(log_ns, content.time_ns)
        self.row.append(self.contents.index(untimed))


@dataclass(slots=True)
class Positions(Times):
    """Poses, fixes, or transforms of one frame.

    `value` has seven numbers a message: position (metres, or latitude and longitude in degrees and height of a fix) and
    quaternion x, y, z, w. `sigma` has three: of position (m) and rotation (rad) of a pose, east, north, up of a fix;
    nan where not stated.
    """

    first: PoseContent | FixContent | None = None
    value: array[float] = field(default_factory=_floats)
    sigma: array[float] = field(default_factory=_floats)

    def add(self, log_ns: int, content: PoseContent | FixContent) -> None:
        """Take in a message."""
        self.first = self.first or content
        self.stamp(log_ns, content.time_ns)
        if isinstance(content, PoseContent):
            self.value.extend((*content.translation, *content.rotation))
            stated = (content.sigma_m, content.sigma_rad, None)
            self.sigma.extend(np.nan if one is None else one for one in stated)
        else:
            fix = content.fix
            self.value.extend((fix.latitude_deg, fix.longitude_deg, fix.altitude_m, 0, 0, 0, 1))
            self.sigma.extend(fix.sigma_m or (np.nan,) * 3)

    @property
    def moves(self) -> bool:
        """Whether the values change by more than rounding."""
        value = self.values()
        turn = 1 - np.abs(value[:, 3:] @ value[0, 3:]) if len(value) else np.zeros(0)
        return bool((np.ptp(value[:, :3], axis=0) > 1e-6).any() or (turn > 1e-6).any())

    def values(self) -> Floats:
        """(n, 7) values, quaternions of length one."""
        value = np.array(self.value, np.float64).reshape(-1, 7)
        value[:, 3:] /= np.linalg.norm(value[:, 3:], axis=1, keepdims=True)
        return value

    def sigmas(self) -> Floats:
        """(n, 3) standard deviations."""
        return np.array(self.sigma, np.float64).reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class Samples:
    """Positions sorted by time, one at a time: time_ns (n,), value (n, 7) and sigma (n, 3) as in `Positions`."""

    time_ns: Integers
    value: Floats
    sigma: Floats

    @staticmethod
    def sorted(time_ns: Integers, value: Floats, sigma: Floats) -> Samples:
        """By time; of several at one time the last."""
        order = np.argsort(time_ns, kind="stable")
        time = time_ns[order]
        order = order[np.append(time[1:] != time[:-1], True)] if len(time) else order
        return Samples(time_ns[order], value[order], sigma[order])

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.time_ns)

    def kept(self, rows: Integers | np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Samples:
        """These rows alone."""
        return Samples(self.time_ns[rows], self.value[rows], self.sigma[rows])
