"""What a log holds, and whether and how it can be used (`wayside info`)."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich import filesize

from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.reading.plan import Plan, make_plan
from wayside.pipeline.reading.survey import LogSurvey, Topic, survey_log
from wayside.pipeline.reading.timeline import Timeline, make_timeline
from wayside.schemas.errors import WaysideError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings

_MOST_PROBLEMS_SHOWN, _MOST_TOPICS_SHOWN, _MOST_CAMERAS = 10, 100, 6
_SPACING_EXAMPLE = ("--spacing", "26.4ft")
_SOME_CAMERA = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)


def inspect_log(path: Path, *, shown: Path | None = None) -> dict[str, Any]:
    """Read a whole log, in bounded memory, and return what it holds: the content of `wayside info --json`.

    `shown`: what is named as the log, the bag that it was made of. Raises InputError where the log cannot be read.
    """
    survey = survey_log(path)
    survey.path = shown or path
    scan, topics = survey.scan, survey.topics.values()
    first = min((topic.first_log_ns for topic in topics), default=0)
    most = sorted(survey.cameras, key=lambda t: (-t.count, t.name))[:_MOST_CAMERAS]
    cameras = sorted(most, key=lambda t: t.name)
    fault = ""
    if not cameras:
        try:
            make_plan(survey, ReadSettings(), None)
        except WaysideError as error:
            fault = _reason(survey, error)
    return {
        "log": str(survey.path),
        "bytes": scan.bytes_total,
        "seconds": (max((topic.last_log_ns for topic in topics), default=0) - first) / 1e9,
        "messages": scan.messages,
        "messages_stated": scan.messages_stated,
        "chunks": scan.chunks,
        "lost_chunks": scan.lost_chunks,
        "compressions": sorted(scan.compressions),
        "topics": [_topic(one) for one in sorted(topics, key=lambda t: (t.name, t.schema))],
        "cameras": [_camera(survey, camera) for camera in cameras],
        "more_cameras": len(survey.cameras) - len(cameras),
        "fault": fault,
        "problem_count": scan.problem_count,
        "problems": [str(problem) for problem in scan.problems],
        "unchecked": scan.unchecked,
    }


def format_log(facts: Mapping[str, Any]) -> str:
    """What `inspect_log` returns, for a person."""
    lines = [_head(facts), "", *_topics(facts["topics"])]
    for camera in facts["cameras"]:
        lines += ["", *_camera_lines(camera)]
    if more := facts["more_cameras"]:
        lines += ["", f"and {counted(more, 'more camera')}"]
    if facts["fault"]:
        lines += ["", f"cannot be used: {facts['fault']}"]
    return "\n".join([*lines, "", *_damage(facts)])


def _reason(survey: LogSurvey, error: WaysideError) -> str:
    return str(error).removeprefix(f"{survey.path}: ")


def _topic(topic: Topic) -> dict[str, Any]:
    seconds, kind = (topic.last_log_ns - topic.first_log_ns) / 1e9, topic.kind
    unusable = kind is not None and topic.first is None
    return {
        "name": topic.name,
        "schema": topic.schema,
        "encoding": topic.encoding,
        "messages": topic.count,
        "rate_hz": (topic.count - 1) / seconds if topic.count > 1 and seconds > 0 else None,
        "used_for": None if kind is None else kind.value,
        "fault": (topic.fault or "none has a value") if unusable else None,
    }


def _camera(survey: LogSurvey, topic: Topic) -> dict[str, Any]:
    """What is known of one camera, and how to use it."""
    usable, command, hindrances = _way(survey, topic)
    calibration: dict[str, Any] | None = None
    motion, notes = "", []
    if usable is not None:
        plan, timeline = usable
        c = plan.first_camera
        if c is not None and c is not _SOME_CAMERA:
            calibration = asdict(c) | {"source": plan.calibration_source}
            if topic.image_size not in (None, (c.width, c.height)):
                hindrances.append(
                    f"the calibration {plan.calibration_source} is of {c.width} x {c.height} pixels"
                )
                command += ["--calibration", "camera.yaml"]
        motion, notes = _motion_words(plan, timeline), [*plan.notes, *timeline.notes]
    width, height = topic.image_size or (None, None)
    return {
        "topic": topic.name,
        "images": topic.count,
        "width": width,
        "height": height,
        "format": topic.image_format,
        "calibration": calibration,
        "motion": motion,
        "notes": notes,
        "hindrances": hindrances,
        "command": None if usable is None else shlex.join(command),
    }


def _camera_lines(camera: Mapping[str, Any]) -> list[str]:
    size = "size unknown" if camera["width"] is None else f"{camera['width']} x {camera['height']}"
    images = counted(camera["images"], "image")
    lines = [f"camera {camera['topic']}: {images}, {size}, {camera['format']}"]
    if c := camera["calibration"]:
        lines.append(
            f"  calibration {c['source']}: {c['width']} x {c['height']}, "
            f"focal length {c['fx']:.1f} {c['fy']:.1f} px, centre {c['cx']:.1f} {c['cy']:.1f} px, "
            f"{len(c['distortion'])} distortion coefficients"
        )
    if camera["motion"]:
        lines.append(f"  motion from {camera['motion']}")
    lines += [f"  note: {note}" for note in camera["notes"]]
    lines += [f"  cannot be used yet: {hindrance}" for hindrance in camera["hindrances"]]
    lead = "add what is missing" if camera["hindrances"] else "can be used"
    return [*lines, *[f"  {lead}: {camera['command']}"] * (camera["command"] is not None)]


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
        # From here on, what the user can give counts as given, so that the next obstacle shows as well.
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


def _head(facts: Mapping[str, Any]) -> str:
    packing = " and ".join(facts["compressions"]).replace("none", "not compressed")
    lost = f", {facts['lost_chunks']} of them lost" if facts["lost_chunks"] else ""
    chunks = f"{counted(facts['chunks'], 'chunk')} ({packing or 'none readable'}){lost}"
    return (
        f"{facts['log']}: {filesize.decimal(facts['bytes'])}, {facts['seconds']:.1f} s, "
        f"{counted(facts['messages'], 'message')}, {chunks if facts['chunks'] else 'no chunks'}"
    )


def _topics(held: Sequence[Mapping[str, Any]]) -> list[str]:
    """A table of the topics of most messages."""
    most = sorted(held, key=lambda t: (-t["messages"], t["name"]))[:_MOST_TOPICS_SHOWN]
    if not most:
        return ["no topics"]
    rows = [("topic", "schema", "encoding", "messages", "rate", "used for")]
    for t in sorted(most, key=lambda t: (t["name"], t["schema"])):
        rate = "" if t["rate_hz"] is None else f"{t['rate_hz']:.1f} Hz"
        use = (t["used_for"] or "") + (f": no usable message ({t['fault']})" if t["fault"] else "")
        kind = t["schema"] or "none", t["encoding"], str(t["messages"])
        rows.append((t["name"], *kind, rate, use))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    more = len(held) - len(most)
    return [*lines, f"and {counted(more, 'more topic')}"] if more else lines


def _damage(facts: Mapping[str, Any]) -> list[str]:
    lines = ["no damage found"]
    if count := facts["problem_count"]:
        shown = [f"  {problem}" for problem in facts["problems"][:_MOST_PROBLEMS_SHOWN]]
        more = count - len(shown)
        tail = [f"  and {more} more"] if more > 0 else []
        where = counted(count, "place")
        lines = [f"damaged in {where}; the rest can be used:", *shown, *tail]
    stated, found = facts["messages_stated"], facts["messages"]
    if stated is not None and stated > found:
        lines.append(f"{stated - found} of the {stated} messages that its summary counts are lost")
    return [*lines, *facts["unchecked"]]
