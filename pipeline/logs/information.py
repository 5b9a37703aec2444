"""What a log holds, and whether and how it can be used (`wayside info`)."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from wayside.pipeline.reading.contents import CalibrationContent
from wayside.pipeline.reading.plan import Plan, make_plan
from wayside.pipeline.reading.survey import LogSurvey, Topic, survey_log
from wayside.pipeline.reading.timeline import Timeline, make_timeline
from wayside.schemas.errors import WaysideError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings

_MOST_PROBLEMS_SHOWN, _MOST_TOPICS_SHOWN, _MOST_CAMERAS_SHOWN = 10, 100, 6
_SPACING_EXAMPLE = ("--spacing", "26.4ft")
_SOME_CAMERA = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Way:
    """One camera of the log and how to use it."""

    camera: Topic
    command: str
    """Empty: none helps."""
    hindrances: tuple[str, ...] = ()
    """What is missing; the command gives it."""
    calibration: Camera | None = None
    calibration_source: str = ""
    motion: str = ""
    notes: tuple[str, ...] = ()
    """What clocks, order and positions of the log lack, and what is done about it."""


@dataclass(frozen=True, slots=True)
class LogInformation:
    """What a whole log was found to hold; `hindrance` says why it cannot be used at all."""

    survey: LogSurvey
    ways: tuple[Way, ...]
    hindrance: str

    @property
    def duration_s(self) -> float:
        """From the first message to the last, seconds of log time."""
        topics = self.survey.topics.values()
        first = min((topic.first_log_ns for topic in topics), default=0)
        return (max((topic.last_log_ns for topic in topics), default=0) - first) / 1e9


def describe_log(path: Path, *, shown: Path | None = None) -> LogInformation:
    """Read a whole log, in bounded memory, and say what it holds; raises InputError where it cannot be read.

    shown: what is named as the log, the bag that it was made of.
    """
    survey = survey_log(path)
    survey.path = path = shown or path
    cameras = sorted(_most(survey.cameras, _MOST_CAMERAS_SHOWN), key=lambda t: t.name)
    hindrance = ""
    if not cameras:
        try:
            make_plan(survey, ReadSettings(), None)
        except WaysideError as error:
            hindrance = str(error).removeprefix(f"{path}: ")
    return LogInformation(survey, tuple(_way(survey, camera) for camera in cameras), hindrance)


def _most(topics: Iterable[Topic], count: int) -> list[Topic]:
    """Those topics that have the most messages."""
    return sorted(topics, key=lambda t: (-t.count, t.name))[:count]


def _way(survey: LogSurvey, camera: Topic) -> Way:
    settings, given = ReadSettings(camera=camera.name), None
    choice = ["--camera", camera.name] if len(survey.cameras) > 1 else []
    command = ["wayside", "run", str(survey.path), *choice, "-o", "out"]
    hindrances: list[str] = []
    timeline = None
    while timeline is None:
        try:
            plan = make_plan(survey, settings, given)
            timeline = make_timeline(plan)
        except WaysideError as error:
            hindrances.append(str(error).removeprefix(f"{survey.path}: "))
            # What the user can give is taken as given from here on, so that the next obstacle shows as well.
            if given is None and "--calibration" in hindrances[-1]:
                given, command = _SOME_CAMERA, [*command, "--calibration", "camera.yaml"]
            elif not settings.spacing_m and "--spacing" in hindrances[-1]:
                settings, command = replace(settings, spacing_m=1.0), [*command, *_SPACING_EXAMPLE]
            else:
                return Way(camera, "", tuple(hindrances))
    calibration = _calibration(plan)
    size = camera.image_size
    if calibration is not None and size not in (None, (calibration.width, calibration.height)):
        hindrances.append(
            f"the calibration {plan.calibration_source} is of {calibration.width} x {calibration.height} pixels"
        )
        command += ["--calibration", "camera.yaml"]
    return Way(
        camera,
        shlex.join(command),
        tuple(hindrances),
        calibration,
        plan.calibration_source,
        _motion_words(plan, timeline),
        (*plan.notes, *timeline.notes),
    )


def _calibration(plan: Plan) -> Camera | None:
    if plan.camera_given is not None:
        return None if plan.camera_given is _SOME_CAMERA else plan.camera_given
    content = None if plan.calibration is None else plan.calibration.first
    return plan.camera_of(content) if isinstance(content, CalibrationContent) else None


def _motion_words(plan: Plan, timeline: Timeline) -> str:
    words = []
    if timeline.motion is not None:
        words.append(f"{timeline.motion.source} {timeline.motion.topic}".rstrip())
    if timeline.fixes is not None and plan.fixes is not None:
        words.append(f"fixes {plan.fixes.name}")
    if plan.survey.spacing_m and timeline.motion is None:
        words.append(f"spacing {plan.spacing_m:.3f} m")
    return ", ".join(words)


def format_information(information: LogInformation) -> str:
    """The information as text for a terminal."""
    lines = [*_head(information), "", *_topics(information)]
    for way in information.ways:
        lines += ["", *_camera(way)]
    if more := len(information.survey.cameras) - len(information.ways):
        lines += ["", f"and {more} more cameras"]
    if information.hindrance:
        lines += ["", f"cannot be used: {information.hindrance}"]
    return "\n".join([*lines, "", *_damage(information)])


def _head(information: LogInformation) -> list[str]:
    scan, path = information.survey.scan, information.survey.path
    packing = " and ".join(sorted(scan.compressions)).replace("none", "not compressed")
    lost = f", {scan.lost_chunks} of them lost" if scan.lost_chunks else ""
    chunks = f"{scan.chunks} chunks ({packing or 'none readable'}){lost}"
    return [
        f"{path}: {_size(scan.bytes_total)}, {information.duration_s:.1f} s, "
        f"{scan.messages} messages, {chunks if scan.chunks else 'no chunks'}"
    ]


def _topics(information: LogInformation) -> list[str]:
    held = information.survey.topics.values()
    topics = sorted(_most(held, _MOST_TOPICS_SHOWN), key=lambda t: (t.name, t.schema))
    if not topics:
        return ["no topics"]
    rows = [("topic", "schema", "encoding", "messages", "rate", "used for")]
    for t in topics:
        seconds = (t.last_log_ns - t.first_log_ns) / 1e9
        rate = f"{(t.count - 1) / seconds:.1f} Hz" if t.count > 1 and seconds > 0 else ""
        use = "" if t.kind is None else t.kind.value
        if t.kind is not None and t.first is None:
            use += f": no usable message ({t.fault or 'none has a value'})"
        rows.append((t.name, t.schema or "none", t.encoding, str(t.count), rate, use))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    return [*lines, f"and {more} more topics"] if (more := len(held) - len(topics)) else lines


def _camera(way: Way) -> list[str]:
    topic, size = way.camera, way.camera.image_size
    shown = "size unknown" if size is None else f"{size[0]} x {size[1]}"
    lines = [f"camera {topic.name}: {topic.count} images, {shown}, {topic.image_format}"]
    if way.calibration is not None:
        c = way.calibration
        lines.append(
            f"  calibration {way.calibration_source}: {c.width} x {c.height}, "
            f"focal length {c.fx:.1f} {c.fy:.1f} px, centre {c.cx:.1f} {c.cy:.1f} px, "
            f"{len(c.distortion)} distortion coefficients"
        )
    if way.motion:
        lines.append(f"  motion from {way.motion}")
    lines += [f"  note: {note}" for note in way.notes]
    if way.hindrances:
        lines += [f"  not as it is: {hindrance}" for hindrance in way.hindrances]
        return [*lines, f"  with what is missing: {way.command}"] if way.command else lines
    return [*lines, f"  can be used: {way.command}"]


def _damage(information: LogInformation) -> list[str]:
    scan = information.survey.scan
    lines = ["no damage found"]
    if scan.problem_count:
        shown = [f"  {problem}" for problem in scan.problems[:_MOST_PROBLEMS_SHOWN]]
        more = scan.problem_count - len(shown)
        tail = [f"  and {more} more"] if more > 0 else []
        places = "1 place" if scan.problem_count == 1 else f"{scan.problem_count} places"
        lines = [f"damaged in {places}; what is whole can be used:", *shown, *tail]
    stated = scan.messages_stated
    if stated is not None and stated > scan.messages:
        lines.append(
            f"{stated - scan.messages} of the {stated} messages that its summary counts are lost"
        )
    return lines + scan.unchecked


def _size(count: int) -> str:
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= factor:
            return f"{count / factor:.1f} {unit}"
    return f"{count} bytes"
