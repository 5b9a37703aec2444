"""What is made of a log's clocks, order and positions before anything of it is used: decided once, over all of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.pipeline.reading.clocks import LogClock, settle_headers, settle_log
from wayside.pipeline.reading.consistency import (
    PositionCheck,
    Series,
    check_positions,
    fix_positions,
    joined,
)
from wayside.pipeline.reading.contents import PoseContent
from wayside.pipeline.reading.plan import Plan, shortened
from wayside.pipeline.reading.poses import bare
from wayside.pipeline.reading.stamps import POSITION, ROTATION, Flags, Floats, Integers
from wayside.pipeline.reading.survey import Topic
from wayside.schemas.settings import ReadSettings

SECOND_NS = 10**9


@dataclass(slots=True)
class Inspection:
    """How each message of a log is to be taken; messages and entries are numbered as in `Stamps`.

    first (m,): first entry of each message; arrival_ns (m,): when it came, on a continuous clock; time_ns (n,): when
    an entry was measured, on the clock common to all; capture_ns (n,): the same on its topic's own clock; wrong (n,):
    left out; moves: rotation (3, 3) and shift (3,) of entries whose origin differs; order: messages in the order of
    time, None where the file has them in it; notes: what was found, in words.
    """

    first: Integers
    arrival_ns: Integers
    time_ns: Integers
    capture_ns: Integers
    wrong: Flags
    moves: dict[int, tuple[Floats, Floats]] = field(default_factory=dict)
    order: Integers | None = None
    notes: list[str] = field(default_factory=list)

    def moved(self, entry: int, content: PoseContent) -> PoseContent:
        """A pose in the frame of the origin of its series that most positions are of."""
        move = self.moves.get(entry)
        if move is None:
            return content
        turn = Rotation.from_matrix(move[0])
        x, y, z = (turn.apply(content.translation) + move[1]).tolist()
        i, j, k, w = (turn * Rotation.from_quat(content.rotation)).as_quat().tolist()
        return replace(content, rotation=(i, j, k, w), translation=(x, y, z))


def inspect_log(plan: Plan, settings: ReadSettings) -> Inspection:
    """Decide times, order and outliers of all messages that the plan reads."""
    return _Inspector(plan, settings).result


class _Inspector:
    """One decision over one log."""

    def __init__(self, plan: Plan, settings: ReadSettings) -> None:
        self.plan, self.settings, self.stamps = plan, settings, plan.survey.stamps
        self.window_ns = round(settings.late_s * SECOND_NS)
        self.far_ns = round(settings.far_s * SECOND_NS)
        self.log_ns, self.message, self.stream, self.header_ns, self.usable, self.value = (
            self.stamps.columns()
        )
        self.names = {number: stream for stream, number in self.stamps.streams.items()}
        self.images = np.flatnonzero(np.isin(self.stream, self._numbers(plan.camera)))
        clock = self._settle_log()
        self.result = Inspection(
            np.array(self.stamps.first, np.int64),
            clock.time_ns,
            clock.time_ns[self.message],
            clock.time_ns[self.message],
            np.zeros(len(self.message), np.bool_),
        )
        self._tell_jumps(clock)
        lateness_ns = self._settle_headers(clock)
        self._order(clock, lateness_ns)
        self._judge_positions()

    def _numbers(self, topic: Topic | None) -> list[int]:
        return [] if topic is None else self.stamps.of_topic((topic.name, topic.schema))

    def _settle_log(self) -> LogClock:
        rows = self.message[self.images]
        return settle_log(self.log_ns, rows, self.header_ns[self.images], self.settings)

    def _tell_jumps(self, clock: LogClock) -> None:
        notes, images = self.result.notes, self.message[self.images]
        if clock.jumps:
            row, size = max(clock.jumps, key=lambda jump: abs(jump[1]))
            times = "once" if len(clock.jumps) == 1 else f"{len(clock.jumps)} times"
            way = "back" if size < 0 else "ahead"
            notes.append(
                f"the clock of the log is set {times}, furthest {_seconds(size)} {way} at image "
                f"{int((images < row).sum())}: the order in the file is used, and times go on from there"
            )
        if count := int(clock.strays.sum()):
            notes.append(
                f"{count} messages are logged at a time far from all others: their place in the file is used"
            )

    def _settle_headers(self, clock: LogClock) -> Integers:
        """Times by headers; how late (n,) each entry was recorded against the images."""
        result, log_ns = self.result, clock.time_ns[self.message]
        order = np.argsort(log_ns, kind="stable") if clock.by_time else np.arange(len(log_ns))
        offsets: dict[int, int] = {}
        for number in self._read():
            rows = order[self.stream[order] == number]
            time_ns, wrong, offset = settle_headers(
                log_ns[rows], self.header_ns[rows], self.window_ns
            )
            result.capture_ns[rows] = time_ns
            offsets[number] = offset
            off = rows[wrong & (self.header_ns[rows] > 0)]
            apart = self.header_ns[off] - self.log_ns[self.message[off]] - offset
            apart = apart[np.abs(apart) > self.window_ns]  # elsewhere both clocks were set alike
            if len(apart):
                self._tell_headers(number, len(rows), apart)
        camera = [offsets[n] for n in self._numbers(self.plan.camera)]
        own = camera[0] if camera else 0
        measured = [*self._numbers(self.plan.motion), *self._numbers(self.plan.fixes)]
        if any(abs(offsets[number] - own) > self.far_ns for number in measured):
            result.time_ns, own = log_ns, 0
            result.notes.append(
                "header times are of different clocks: log times pair poses and images"
            )
        else:
            result.time_ns = result.capture_ns
        return np.asarray(log_ns - (result.time_ns - own))

    def _read(self) -> list[int]:
        """Streams that the plan reads."""
        plan = self.plan
        topics = (plan.camera, plan.calibration, plan.motion, plan.fixes)
        read = {(t.name, t.schema) for t in topics if t is not None}
        moving = set(self._moving())
        return [n for n, name in self.names.items() if name[:2] in read or n in moving]

    def _tell_headers(self, number: int, count: int, apart: Integers) -> None:
        furthest = int(apart[np.argmax(np.abs(apart))])
        way = "ahead" if furthest > 0 else "back"
        self.result.notes.append(
            f"{len(apart)} of {count} header times of {shortened(self.names[number][0])} are off, furthest "
            f"{_seconds(furthest)} {way}: their log times are used"
        )

    def _order(self, clock: LogClock, lateness_ns: Integers) -> None:
        """Sort all messages by time where images, or what belongs to them, are not in the order of the file."""
        result = self.result
        calibration = self._numbers(self.plan.calibration)
        measured = np.isin(self.stream, [n for n in self._read() if n not in calibration])
        if not len(self.images) or not (
            clock.by_time
            or (np.diff(result.time_ns[self.images]) < 0).any()
            or (lateness_ns[measured] > self.window_ns).any()
        ):
            return
        result.arrival_ns = result.time_ns[result.first]
        result.order = np.argsort(result.arrival_ns, kind="stable")
        if clock.by_time:
            result.notes.append(
                "the messages stand in the file in another order than their log times: they are read in order of time"
            )

    def _judge_positions(self) -> None:
        plan = self.plan
        if plan.motion_source == "transforms":
            children = dict.fromkeys(bare(self.names[n][2]) for n in self._moving())
            for child in children:
                numbers = [n for n in self._moving() if bare(self.names[n][2]) == child]
                self._judge(numbers, f"transforms of {shortened(child)}")
        elif plan.motion is not None:
            what = "poses" if plan.motion_source == "poses" else "odometry messages"
            self._judge(self._numbers(plan.motion), f"{what} of {shortened(plan.motion.name)}")
        if plan.fixes is not None:
            self._judge(
                self._numbers(plan.fixes), f"fixes of {shortened(plan.fixes.name)}", earth=True
            )

    def _moving(self) -> list[int]:
        """Streams of the transforms that carry the camera and move."""
        if self.plan.motion_source != "transforms":
            return []
        tree = self.plan.survey.tree
        chain = tree.chain(self.plan.camera_frame)
        children = {child for child, edge in tree.edges.items() if edge.moves and edge in chain}
        return [number for number, name in self.names.items() if bare(name[2]) in children]

    def _judge(self, numbers: list[int], what: str, *, earth: bool = False) -> None:
        result = self.result
        rows = np.flatnonzero(np.isin(self.stream, numbers) & self.usable)
        rows = rows[np.argsort(result.time_ns[rows], kind="stable")]
        if len(rows) < 2:
            return
        given = self.value[rows]
        position = fix_positions(given[:, POSITION]) if earth else given[:, POSITION]
        time_s = (result.time_ns[rows] - result.time_ns[rows[0]]) / SECOND_NS
        series = Series(time_s, position, None if earth else given[:, ROTATION])
        checked = check_positions(series, self.settings, origin_may_move=not earth)
        result.wrong[rows[checked.wrong]] = True
        result.notes += _words(series, checked, what)
        if checked.origin.any():
            moves = joined(series, checked)
            for k in np.flatnonzero(checked.origin * ~checked.wrong).tolist():
                result.moves[int(rows[k])] = moves[int(checked.origin[k])]


def _words(series: Series, checked: PositionCheck, what: str) -> Iterator[str]:
    wrong = np.flatnonzero(checked.wrong)
    if len(wrong):
        kept = np.flatnonzero(~checked.wrong)
        nearest = np.searchsorted(kept, wrong).clip(max=len(kept) - 1)
        off = np.linalg.norm(series.position[wrong] - series.position[kept[nearest]], axis=1)
        furthest = int(np.argmax(off))
        yield (
            f"{len(wrong)} of {len(series.time_s)} {what} are where no vehicle can be, up to {off[furthest]:.0f} m "
            f"from the next sound one ({series.time_s[wrong[furthest]]:.1f} s after the first): left out"
        )
    if checked.origin.any():
        count = len(np.unique(checked.origin)) - 1
        times = "once" if count == 1 else f"{count} times"
        yield (
            f"the origin of the {what} moves {times}: the speed before is kept across, and positions behind are "
            "in the frame of the longest part"
        )


def _seconds(ns: int) -> str:
    seconds = abs(ns) / SECOND_NS
    if seconds > 2 * 86400:
        return f"{seconds / 86400:.0f} days"
    return f"{seconds:.1f} s" if seconds < 600 else f"{seconds / 60:.0f} minutes"
