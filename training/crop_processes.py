"""Crops with their targets and their boxes, made in batches by several processes and taken in one order.

A batch is the same for the same seed and number, however many processes there are. Images and batches lie in memory
that all processes share.
"""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from multiprocessing.context import SpawnContext
from multiprocessing.queues import Queue
from pathlib import Path
from queue import Empty
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.box_samples import boxes_of_crop
from wayside.pipeline.learning.camera_effects import Noise, make_noise
from wayside.pipeline.learning.detector_crops import CELLS, CROP_PX, Crop, drawn_crop, targets
from wayside.pipeline.learning.detector_images import LabelledImage
from wayside.pipeline.learning.face_drawings import FaceLibrary
from wayside.pipeline.learning.training_images import drawing_probability
from wayside.stages.detection import STRIDE, DetectionNetwork

TOGETHER, WAITING = 16, 3
"""Crops of a batch, and batches that wait for each process, at most."""

BOXES = 40
"""Boxes of a crop, at most; the others are left out."""

LOOK_EVERY_S = 5.0
"""While crops are waited for, it is looked whether the process that makes them is alive."""

_WIDE = CROP_PX // STRIDE

COLUMNS: dict[str, tuple[type[np.generic], tuple[int, ...]]] = {
    "rgb": (np.uint8, (CROP_PX, CROP_PX, 3)),
    "heat": (np.float16, (2, _WIDE, _WIDE)),
    "doubt": (np.uint8, (2, _WIDE, _WIDE)),
    "cell": (np.int32, (CELLS,)),
    "box": (np.float32, (CELLS, 4)),
    "weight": (np.float32, (CELLS,)),
    "color": (np.int64, (CELLS,)),
    "shape": (np.int64, (CELLS,)),
    "boxes": (np.float32, (BOXES, 4)),
    "panel": (np.float32, (BOXES, 2)),
    "panel_weight": (np.float32, (BOXES, 2)),
    "offset": (np.float32, (BOXES, 4)),
    "box_color": (np.int64, (BOXES,)),
    "box_shape": (np.int64, (BOXES,)),
    "count": (np.int32, ()),
    "held_out": (np.bool_, ()),
}
"""What a crop consists of, type and shape by name: the fields of `Crop`, the columns of `BoxTargets` for `count` boxes,
and whether its image is held out."""

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class TrainingSet:
    """What crops are made of: images, which of them are held out (images,), faces that are drawn in."""

    images: Sequence[LabelledImage]
    held_out: NDArray[np.bool_]
    library: FaceLibrary


@dataclass(frozen=True, slots=True)
class _SharedSet:
    """A training set whose arrays lie in shared memory: pickled without them, the memory, and where each array ends."""

    content: bytes
    memory: Any
    ends: tuple[int, ...]

    @classmethod
    def of(cls, training_set: TrainingSet, context: SpawnContext) -> _SharedSet:
        """Copy the arrays into shared memory."""
        buffers: list[pickle.PickleBuffer] = []
        content = pickle.dumps(training_set, protocol=5, buffer_callback=buffers.append)
        parts = [buffer.raw() for buffer in buffers]
        ends = np.cumsum([0, *(part.nbytes for part in parts)]).tolist()
        memory = context.RawArray("B", max(ends[-1], 1))
        held = np.frombuffer(memory, np.uint8)
        for part, begin, end in zip(parts, ends, ends[1:], strict=False):
            held[begin:end] = part
        return cls(content, memory, tuple(ends))

    def training_set(self) -> TrainingSet:
        """The training set, its arrays in shared memory."""
        held = memoryview(self.memory).cast("B")
        parts = [held[begin:end] for begin, end in zip(self.ends, self.ends[1:], strict=False)]
        return cast("TrainingSet", pickle.loads(self.content, buffers=parts))


@dataclass(frozen=True, slots=True)
class _BatchSlots:
    """Shared memory of `WAITING` batches that a process writes, and which of these slots are free and full."""

    memory: dict[str, Any]
    free: Queue[int]
    full: Queue[int]

    @classmethod
    def made(cls, context: SpawnContext) -> _BatchSlots:
        """All free."""
        size = WAITING * TOGETHER
        memory = {
            name: context.RawArray("B", size * int(np.prod(shape)) * np.dtype(kind).itemsize)
            for name, (kind, shape) in COLUMNS.items()
        }
        slots = cls(memory, context.Queue(), context.Queue())
        for slot in range(WAITING):
            slots.free.put(slot)
        return slots

    def columns(self) -> Columns:
        """The memory as arrays (`WAITING`, `TOGETHER`, ...)."""
        return {
            name: np.frombuffer(self.memory[name], kind).reshape(WAITING, TOGETHER, *shape)
            for name, (kind, shape) in COLUMNS.items()
        }


class CropProcesses:
    """Batches of crops in the order of their numbers.

    training_set: what crops are made of, where the processes read it; columns: the memory of each process, (`WAITING`,
    `TOGETHER`, ...) by name; number: of the next batch.
    """

    def __init__(
        self,
        training_set: TrainingSet,
        slots: Sequence[_BatchSlots],
        processes: Sequence[Any],
        number: int,
    ) -> None:
        self.training_set, self.number = training_set, number
        self._slots, self._processes = slots, processes
        self.columns = [one.columns() for one in slots]

    def taken(self) -> tuple[int, int]:
        """Process and slot of the next batch; it stays there until it is given back.

        Raises RuntimeError where that process has died.
        """
        one = self.number % len(self._slots)
        self.number += 1
        while True:
            alive = self._processes[one].is_alive()
            try:
                return one, self._slots[one].full.get(timeout=LOOK_EVERY_S)
            except Empty:
                if not alive:
                    raise RuntimeError("a process that makes the crops has died") from None

    def free(self, process: int, slot: int) -> None:
        """Let new crops be written there."""
        self._slots[process].free.put(slot)


@contextmanager
def crops_made(
    training_set: TrainingSet, proposing: Path, processes: int, seed: int, first: int = 0
) -> Iterator[CropProcesses]:
    """Processes that make crops from batch `first` on, with the boxes that a detection network proposes.

    The training set is copied into shared memory, gigabytes: hold no other copy of it.
    """
    context = multiprocessing.get_context("spawn")
    shared = _SharedSet.of(training_set, context)
    training_set = shared.training_set()
    slots = [_BatchSlots.made(context) for _ in range(processes)]
    workers = []
    for k, one in enumerate(slots):
        begin = first + (k - first) % processes
        given = (shared, proposing, one, seed, begin, processes)
        workers.append(context.Process(target=_make_crops, args=given, daemon=True))
        workers[-1].start()
    try:
        yield CropProcesses(training_set, slots, workers, first)
    finally:
        for worker in workers:
            worker.terminate()


def _make_crops(
    shared: _SharedSet, proposing: Path, slots: _BatchSlots, seed: int, number: int, each: int
) -> None:
    cv2.setNumThreads(1)
    training_set, columns = shared.training_set(), slots.columns()
    network = DetectionNetwork(str(proposing))
    noise = make_noise(np.random.default_rng(seed))
    probability = drawing_probability(training_set.images)
    while (slot := _free_slot(slots)) is not None:
        rng = np.random.default_rng([seed, number])
        chosen = rng.choice(len(training_set.images), TOGETHER, p=probability)
        for row, k in enumerate(chosen.tolist()):
            made = crop_with_boxes(
                training_set.images[k], network, training_set.library, noise, rng
            )
            for name, value in made.items():
                columns[name][slot, row] = value
            columns["held_out"][slot, row] = training_set.held_out[k]
        slots.full.put(slot)
        number += each


def _free_slot(slots: _BatchSlots) -> int | None:
    """A free slot; None where the process that takes the crops has died."""
    parent = multiprocessing.parent_process()
    while parent is None or parent.is_alive():
        try:
            return slots.free.get(timeout=LOOK_EVERY_S)
        except Empty:
            continue
    return None


def crop_with_boxes(
    image: LabelledImage,
    network: DetectionNetwork,
    library: FaceLibrary,
    noise: Noise,
    rng: np.random.Generator,
) -> Columns:
    """A crop of an image with its boxes: `COLUMNS` but for `held_out`."""
    pixels, labels = drawn_crop(image, library, noise, rng)
    crop = targets(pixels, labels, image)
    found = boxes_of_crop(pixels, labels, crop.doubt, network, rng)
    rows = rng.permutation(len(found.box))[:BOXES]
    of_boxes: Columns = {
        "boxes": found.box,
        "panel": found.panel,
        "panel_weight": found.weight,
        "offset": found.offset,
        "box_color": found.color,
        "box_shape": found.shape,
    }
    made: Columns = {one.name: getattr(crop, one.name) for one in fields(Crop)}
    made["count"] = np.array(len(rows), np.int32)
    for name, values in of_boxes.items():
        kind, shape = COLUMNS[name]
        made[name] = np.zeros(shape, kind)
        made[name][: len(rows)] = values[rows]
    return made
