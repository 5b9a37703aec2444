"""Faults of clocks, order and positions, written into a log of Foxglove messages by the stock MCAP writer."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from logged_messages import (
    CALIBRATION,
    GPS,
    IMAGE,
    POSE,
    TYPES,
    Edit,
    Messages,
    edited,
)

SECOND, HOUR, YEAR = 10**9, 3600 * 10**9, 365 * 86400 * 10**9


def moved(
    ns: int,
    messages: Messages,
    *,
    since: int = 0,
    until: int = 10**9,
    topics: Sequence[str] = tuple(TYPES),
    header: bool = True,
    log: bool = True,
) -> Messages:
    """Move times of the messages numbered from `since` to before `until` of some topics."""
    return [
        edited(m, header_ns=ns * header, log_ns=ns * log)
        if m.topic in topics and since <= m.number < until
        else m
        for m in messages
    ]


def without(messages: Messages, *topics: str, keep: range = range(0)) -> Messages:
    """Leave out the messages of topics, those numbered in `keep` excepted."""
    return [m for m in messages if m.topic not in topics or m.number in keep]


def changed(
    change: Callable[[Any], None],
    messages: Messages,
    *,
    topic: str = POSE,
    since: int = 0,
    until: int = 10**9,
) -> Messages:
    """Change the content of the messages numbered from `since` to before `until` of a topic."""
    return [
        edited(m, change) if m.topic == topic and since <= m.number < until else m for m in messages
    ]


def swapped_chunks(messages: Messages) -> Messages:
    """Exchange the third and the sixth eighth of the log."""
    n = len(messages) // 8
    parts = [messages[i * n : (i + 1) * n] for i in range(7)] + [messages[7 * n :]]
    parts[2], parts[5] = parts[5], parts[2]
    return [m for part in parts for m in part]


def late(messages: Messages, window_ns: int = SECOND) -> Messages:
    """Write each message up to a window late, drawn by chance from a fixed seed."""
    draw = random.Random(7)
    return sorted(messages, key=lambda m: m.log_ns + draw.randrange(window_ns))


def swapped_messages(messages: Messages, first: int = 10, second: int = 14) -> Messages:
    """Exchange the places of two image messages in the file; their times stay theirs."""
    a, b = (
        next(i for i, m in enumerate(messages) if m.topic == IMAGE and m.number == n)
        for n in (first, second)
    )
    messages = list(messages)
    messages[a], messages[b] = messages[b], messages[a]
    return messages


def swapped_pixels(messages: Messages, first: int = 10, second: int = 11) -> Messages:
    """Exchange the pixels of two images; times and places in the file stay."""
    pixels = {}
    for m in messages:
        if m.topic == IMAGE and m.number in (first, second):
            pixels[m.number] = CompressedImage.FromString(m.data).data
    result = []
    for m in messages:
        if m.topic == IMAGE and m.number in pixels:
            other = pixels[second if m.number == first else first]
            m = edited(m, lambda c, other=other: setattr(c, "data", other))
        result.append(m)
    return result


def scaled(messages: Messages, factor: float) -> Messages:
    """Images and calibration at another size, so that runs cost less."""

    def smaller(content: Any) -> None:
        pixels = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR)
        small = cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        content.data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()

    def smaller_camera(content: Any) -> None:
        content.width, content.height = (
            round(size * factor) for size in (content.width, content.height)
        )
        for matrix in (content.K, content.P):
            width = len(matrix) // 3
            for k in range(2 * width):
                middle = 0.5 if k % width == 2 else 0.0  # that of the first pixel lies at 0
                matrix[k] = (matrix[k] + middle) * factor - middle

    changes = {IMAGE: smaller, CALIBRATION: smaller_camera}
    return [edited(m, changes.get(m.topic)) for m in messages]


def shift(metres: float) -> Callable[[Any], None]:
    """A change that moves a pose."""

    def change(content: Any) -> None:
        content.pose.position.x += metres

    return change


def put(**values: float) -> Callable[[Any], None]:
    """A change that sets fields of a fix, or x, y, z of a pose."""

    def change(content: Any) -> None:
        target = content.pose.position if hasattr(content, "pose") else content
        for name, value in values.items():
            setattr(target, name, value)

    return change


def north(degrees: float) -> Callable[[Any], None]:
    """A change that moves a fix."""

    def change(content: Any) -> None:
        content.latitude += degrees

    return change


def covariance(variance: float) -> Callable[[Any], None]:
    """A change that states the covariance of a fix."""

    def change(content: Any) -> None:
        del content.position_covariance[:]
        content.position_covariance.extend([variance, 0, 0, 0, variance, 0, 0, 0, variance])
        content.position_covariance_type = 2

    return change


def no_focal(content: Any) -> None:
    """Make a calibration unusable."""
    content.K[0] = float("nan")


def longer(length: float) -> Callable[[Any], None]:
    """A change that makes the quaternion of a pose so many times as long."""

    def change(content: Any) -> None:
        turn = content.pose.orientation
        turn.x, turn.y, turn.z, turn.w = (
            length * part for part in (turn.x, turn.y, turn.z, turn.w)
        )

    return change


def emptied(content: Any) -> None:
    """An image without a byte."""
    content.data = b""


def halved(messages: Messages, topics: Sequence[str], since: int = 12) -> Messages:
    """Calibrations or images at half the size from one on."""
    return [scaled([m], 0.5)[0] if m.topic in topics and m.number >= since else m for m in messages]


def with_other_camera(messages: Messages) -> Messages:
    """Between images, mirrored ones under another `frame_id` in the same topic."""
    half_ns = 160_000_000

    def mirrored(content: Any) -> None:
        pixels = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR)
        content.frame_id = "rear"
        content.data = cv2.imencode(".jpg", pixels[:, ::-1])[1].tobytes()

    rear = [
        edited(m, mirrored, header_ns=half_ns, log_ns=half_ns) for m in messages if m.topic == IMAGE
    ]
    return sorted([*messages, *rear], key=lambda m: m.log_ns)


def no_poses(edit: Edit) -> Edit:
    """The same without poses: the drive goes by its fixes."""
    return lambda messages: edit(without(messages, POSE))


def no_fixes(edit: Edit) -> Edit:
    """The same without fixes: the drive goes by its poses."""
    return lambda messages: edit(without(messages, GPS))


def alone(edit: Edit) -> Edit:
    """The same with images and calibration only."""
    return lambda messages: edit(without(messages, POSE, GPS))


NAN = float("nan")
SPACING = ("--spacing", "8.0467m")
ATTACKS: dict[str, tuple[Edit, tuple[str, ...]]] = {
    "as recorded": (list, ()),
    "as recorded, fixes only": (no_poses(list), ()),
    "as recorded, --spacing only": (alone(list), SPACING),
    # Clocks
    "all clocks back an hour from image 4": (partial(moved, -HOUR, since=4), ()),
    "all clocks back an hour from image 12": (partial(moved, -HOUR, since=12), ()),
    "the same, fixes only": (no_poses(partial(moved, -HOUR, since=12)), ()),
    "the same, --spacing only": (alone(partial(moved, -HOUR, since=12)), SPACING),
    "all clocks back 3 s from image 12": (partial(moved, -3 * SECOND, since=12), ()),
    "all clocks ahead an hour from image 12": (partial(moved, HOUR, since=12), ()),
    "log clock back an hour, headers sound": (
        partial(moved, -HOUR, since=12, header=False),
        (),
    ),
    "headers back an hour, log clock sound": (partial(moved, -HOUR, since=12, log=False), ()),
    "camera clock back an hour, others sound": (
        partial(moved, -HOUR, since=12, topics=(IMAGE,), log=False),
        (),
    ),
    "first image a year ahead": (partial(moved, YEAR, until=1, topics=(IMAGE,)), ()),
    "first messages a year ahead": (partial(moved, YEAR, until=1), ()),
    "one image header a year ahead": (
        partial(moved, YEAR, since=10, until=11, topics=(IMAGE,), log=False),
        (),
    ),
    "one image header a year back": (
        partial(moved, -YEAR, since=10, until=11, topics=(IMAGE,), log=False),
        (),
    ),
    "one pose header a year ahead": (
        partial(moved, YEAR, since=10, until=11, topics=(POSE,), log=False),
        (),
    ),
    "one fix header a year ahead, fixes only": (
        no_poses(partial(moved, YEAR, since=10, until=11, topics=(GPS,), log=False)),
        (),
    ),
    "pose headers a year ahead": (partial(moved, YEAR, topics=(POSE,), log=False), ()),
    # Order
    "two chunks swapped": (swapped_chunks, ()),
    "messages reversed": (lambda m: m[::-1], ()),
    "messages reversed, fixes only": (no_poses(lambda m: m[::-1]), ()),
    "messages reversed, --spacing only": (alone(lambda m: m[::-1]), SPACING),
    "messages up to 1 s late": (late, ()),
    "messages up to 1 s late, fixes only": (no_poses(late), ()),
    "two image messages swapped": (swapped_messages, ()),
    "pixels of two images swapped": (swapped_pixels, ()),
    "pixels of two images swapped, --spacing only": (alone(swapped_pixels), SPACING),
    # Gaps
    "one pose missing": (lambda m: [x for x in m if x.topic != POSE or x.number != 10], ()),
    "one pose missing, no fixes": (
        no_fixes(lambda m: [x for x in m if x.topic != POSE or x.number != 10]),
        (),
    ),
    "poses from image 8 on, no fixes": (
        no_fixes(lambda m: without(m, POSE, keep=range(8, 24))),
        (),
    ),
    "poses from image 8 on, --spacing": (
        no_fixes(lambda m: without(m, POSE, keep=range(8, 24))),
        SPACING,
    ),
    "poses until image 16, no fixes": (no_fixes(lambda m: without(m, POSE, keep=range(16))), ()),
    "poses until image 16, --spacing": (
        no_fixes(lambda m: without(m, POSE, keep=range(16))),
        SPACING,
    ),
    # Outliers
    "one pose off by 5 km": (partial(changed, shift(5000.0), since=10, until=11), ()),
    "one pose off by 20 m": (partial(changed, shift(20.0), since=10, until=11), ()),
    "three poses off by 5 km": (partial(changed, shift(5000.0), since=10, until=13), ()),
    "first pose off by 5 km": (partial(changed, shift(5000.0), until=1), ()),
    "poses jump by 5 km and stay": (partial(changed, shift(5000.0), since=12), ()),
    "one pose at 1e308": (partial(changed, put(x=1e308), since=10, until=11), ()),
    "all poses NaN": (partial(changed, put(x=NAN)), ()),
    "all poses NaN, no fixes": (no_fixes(partial(changed, put(x=NAN))), ()),
    "one fix off by 5 km": (partial(changed, north(0.045), topic=GPS, since=10, until=11), ()),
    "one fix off by 5 km, fixes only": (
        no_poses(partial(changed, north(0.045), topic=GPS, since=10, until=11)),
        (),
    ),
    "first fix off by 5 km, fixes only": (
        no_poses(partial(changed, north(0.045), topic=GPS, until=1)),
        (),
    ),
    "all fixes NaN": (partial(changed, put(latitude=NAN), topic=GPS), ()),
    "half of the fixes NaN, fixes only": (
        no_poses(partial(changed, put(latitude=NAN), topic=GPS, since=12)),
        (),
    ),
    "one altitude 1e15": (partial(changed, put(altitude=1e15), topic=GPS, since=10, until=11), ()),
    "all altitudes 1e15": (partial(changed, put(altitude=1e15), topic=GPS), ()),
    "covariance 1e16 of one fix": (
        partial(changed, covariance(1e16), topic=GPS, since=10, until=11),
        (),
    ),
    "covariance 1e16 of all fixes": (partial(changed, covariance(1e16), topic=GPS), ()),
    "covariance 1e16 of all fixes, fixes only": (
        no_poses(partial(changed, covariance(1e16), topic=GPS)),
        (),
    ),
    "covariance 9e5 of all fixes, fixes only": (
        no_poses(partial(changed, covariance(9e5), topic=GPS)),
        (),
    ),
    "calibration NaN from the third on": (
        partial(changed, no_focal, topic=CALIBRATION, since=2),
        (),
    ),
    # Content
    "one quaternion of length 7": (partial(changed, longer(7.0), since=10, until=11), ()),
    "covariance -1 of all fixes, fixes only": (
        no_poses(partial(changed, covariance(-1.0), topic=GPS)),
        (),
    ),
    "covariance NaN of one fix": (
        partial(changed, covariance(NAN), topic=GPS, since=10, until=11),
        (),
    ),
    "calibration half as large from image 12": (partial(halved, topics=(CALIBRATION,)), ()),
    "calibration and images half as large from image 12": (
        partial(halved, topics=(CALIBRATION, IMAGE)),
        (),
    ),
    "one image without a byte": (
        partial(changed, emptied, topic=IMAGE, since=10, until=11),
        (),
    ),
    "images of another camera between": (with_other_camera, ()),
    "all sequence numbers alike": (lambda m: [replace(x, number=7) for x in m], ()),
}
