"""What a log holds, and whether and how it can be used (`wayside info`)."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from wayside.pipeline.reading.plan import Plan, make_plan
from wayside.pipeline.reading.survey import LogSurvey, Topic, survey_log
from wayside.pipeline.reading.timeline import Timeline, make_timeline
from wayside.schemas.errors import WaysideError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings

_MOST_PROBLEMS_SHOWN, _MOST_TOPICS_SHOWN, _MOST_CAMERAS_SHOWN = 10, 100, 6
_SPACING_EXAMPLE = ("--spacing", "26.4ft")
_SOME_CAMERA = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)


def describe_log(path: Path, *, shown: Path | None = None) -> str:
    """Read a whole log, in bounded memory, and say what it holds; raises InputError where it cannot be read.

    shown: what is named as the log, the bag that it was made of.
    """
    survey = survey_log(path)
    survey.path = shown or path
    cameras = sorted(_most(survey.cameras, _MOST_CAMERAS_SHOWN), key=lambda t: t.name)
    lines = [_head(survey), "", *_topics(survey)]
    for camera in cameras:
        lines += ["", *_camera(survey, camera)]
    if more := len(survey.cameras) - len(cameras):
        lines += ["", f"and {more} more cameras"]
    if not cameras:
        try:
            make_plan(survey, ReadSettings(), None)
        except WaysideError as error:
            lines += ["", f"cannot be used: {_reason(survey, error)}"]
    return "\n".join([*lines, "", *_damage(survey)])


def _most(topics: Iterable[Topic], count: int) -> list[Topic]:
    """Those topics that have the most messages."""
    return sorted(topics, key=lambda t: (-t.count, t.name))[:count]


def _reason(survey: LogSurvey, error: WaysideError) -> str:
    return str(error).removeprefix(f"{survey.path}: ")


def _camera(survey: LogSurvey, topic: Topic) -> list[str]:
    """What is known of one camera, and how to use it."""
    size = topic.image_size
    shown = "size unknown" if size is None else f"{size[0]} x {size[1]}"
    lines = [f"camera {topic.name}: {topic.count} images, {shown}, {topic.image_format}"]
    usable, command, hindrances = _way(survey, topic)
    if usable is not None:
        plan, timeline = usable
        c = plan.first_camera
        if c is not None and c is not _SOME_CAMERA:
            lines.append(
                f"  calibration {plan.calibration_source}: {c.width} x {c.height}, "
                f"focal length {c.fx:.1f} {c.fy:.1f} px, centre {c.cx:.1f} {c.cy:.1f} px, "
                f"{len(c.distortion)} distortion coefficients"
            )
            if size not in (None, (c.width, c.height)):
                hindrances.append(
                    f"the calibration {plan.calibration_source} is of {c.width} x {c.height} pixels"
                )
                command += ["--calibration", "camera.yaml"]
        if motion := _motion_words(plan, timeline):
            lines.append(f"  motion from {motion}")
        lines += [f"  note: {note}" for note in (*plan.notes, *timeline.notes)]
    lines += [f"  not as it is: {hindrance}" for hindrance in hindrances]
    if usable is None:
        return lines
    lead = "with what is missing" if hindrances else "can be used"
    return [*lines, f"  {lead}: {shlex.join(command)}"]


def _way(
    survey: LogSurvey, camera: Topic
) -> tuple[tuple[Plan, Timeline] | None, list[str], list[str]]:
    """How a camera is read (None: nothing helps), the command for it, and what is missing and given in the command."""
    settings, given = ReadSettings(camera=camera.name), None
    choice = ["--camera", camera.name] if len(survey.cameras) > 1 else []
    command = ["wayside", "run", str(survey.path), *choice, "-o", "out"]
    hindrances: list[str] = []
    while True:
        try:
            plan = make_plan(survey, settings, given)
            return (plan, make_timeline(plan)), command, hindrances
        except WaysideError as error:
            hindrances.append(_reason(survey, error))
        # What the user can give is taken as given from here on, so that the next obstacle shows as well.
        if given is None and "--calibration" in hindrances[-1]:
            given, command = _SOME_CAMERA, [*command, "--calibration", "camera.yaml"]
        elif not settings.spacing_m and "--spacing" in hindrances[-1]:
            settings, command = replace(settings, spacing_m=1.0), [*command, *_SPACING_EXAMPLE]
        else:
            return None, command, hindrances


def _motion_words(plan: Plan, timeline: Timeline) -> str:
    words = []
    if timeline.motion is not None:
        words.append(f"{timeline.motion.source} {timeline.motion.topic}".rstrip())
    if timeline.fixes is not None and plan.fixes is not None:
        words.append(f"fixes {plan.fixes.name}")
    if plan.survey.spacing_m and timeline.motion is None:
        words.append(f"spacing {plan.spacing_m:.3f} m")
    return ", ".join(words)


def _head(survey: LogSurvey) -> str:
    scan, topics = survey.scan, survey.topics.values()
    first = min((topic.first_log_ns for topic in topics), default=0)
    seconds = (max((topic.last_log_ns for topic in topics), default=0) - first) / 1e9
    packing = " and ".join(sorted(scan.compressions)).replace("none", "not compressed")
    lost = f", {scan.lost_chunks} of them lost" if scan.lost_chunks else ""
    chunks = f"{scan.chunks} chunks ({packing or 'none readable'}){lost}"
    return (
        f"{survey.path}: {_size(scan.bytes_total)}, {seconds:.1f} s, "
        f"{scan.messages} messages, {chunks if scan.chunks else 'no chunks'}"
    )


def _topics(survey: LogSurvey) -> list[str]:
    held = survey.topics.values()
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


def _damage(survey: LogSurvey) -> list[str]:
    scan = survey.scan
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
