"""Crops with their targets and boxes: made in batches by processes, and held on the device that learns from them.

A batch is the same for the same seed and number, however many processes there are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from training.box_samples import BoxTargets, boxes_of_crop
from training.camera_effects import Noise, make_noise
from training.detector_crops import Crop, drawn_crop, targets
from training.detector_images import LabelledImage, drawing_probability
from training.face_drawings import FaceLibrary
from wayside.stages.detection import DetectionNetwork, drawn_patches

TOGETHER, WAITING = 16, 3
"""Crops of a batch, and batches that wait for each process, at most."""

BOXES = 24
"""Boxes of a crop, at most; the others are left out."""

Columns = dict[str, NDArray[Any]]
"""Of a crop: the fields of `Crop`; those of `BoxTargets`, with a patch for the box, for `count` boxes, then zeros."""


class CropBatches(Dataset):  # type: ignore[misc]
    """Crops of images by the number of their batch, with the boxes that a detection network proposes."""

    def __init__(
        self, images: Sequence[LabelledImage], library: FaceLibrary, proposing: Path, seed: int
    ) -> None:
        self.images, self.library = images, library
        self._proposing, self._seed = proposing, seed
        self._probability = drawing_probability(images)
        self._noise = make_noise(np.random.default_rng(seed))

    @cached_property
    def _network(self) -> DetectionNetwork:
        """Of this process: a session of onnxruntime cannot be shared."""
        return DetectionNetwork(str(self._proposing))

    def __getitem__(self, number: int) -> Columns:
        """The crops of a batch, (`TOGETHER`, ...) by column."""
        rng = np.random.default_rng([self._seed, number])
        chosen = rng.choice(len(self.images), TOGETHER, p=self._probability)
        made = [
            crop_with_boxes(self.images[k], self._network, self.library, self._noise, rng)
            for k in chosen
        ]
        return {name: np.stack([one[name] for one in made]) for name in made[0]}

    def loader(self, processes: int, first: int, *, pinned: bool) -> DataLoader:
        """Batches from number `first` on, without end; pinned: in memory that an accelerator copies from."""
        # a process that is forked beside threads of OpenCV would wait for them forever
        cv2.setNumThreads(1)
        return DataLoader(
            self,
            batch_size=None,
            sampler=count(first),
            num_workers=processes,
            prefetch_factor=WAITING,
            pin_memory=pinned,
        )


def crop_with_boxes(
    image: LabelledImage,
    network: DetectionNetwork,
    library: FaceLibrary,
    noise: Noise,
    rng: np.random.Generator,
) -> Columns:
    """A crop of an image with its boxes, by column."""
    drawn = drawn_crop(image, library, noise, rng)
    crop = targets(drawn)
    found = boxes_of_crop(drawn, crop.doubt, network, rng)
    rows = rng.permutation(len(found.box))[:BOXES]
    made: Columns = {one.name: getattr(crop, one.name) for one in fields(Crop)}
    made["count"] = np.array(len(rows), np.int32)
    of_boxes = {one.name: getattr(found, one.name)[rows] for one in fields(BoxTargets)}
    of_boxes["patch"] = drawn_patches(drawn.rgb, of_boxes.pop("box"))
    for name, values in of_boxes.items():
        unused = [(0, BOXES - len(rows)), *[(0, 0)] * (values.ndim - 1)]
        made[f"of_box_{name}"] = np.pad(values, unused)
    return made


KEPT, KEPT_SHARE = 6_000, 0.6
"""Crops of 0.4 MB that a processor keeps; an accelerator keeps what fills this fraction of its free memory."""


class CropBuffer:
    """Crops by column; made: how many were added."""

    def __init__(self, device: torch.device, kept: int = KEPT) -> None:
        self.columns: dict[str, Tensor] = {}
        self.device, self.kept, self.made = device, kept, 0

    def add(self, crops: Mapping[str, Tensor]) -> None:
        """Add crops (n, ...) by column, in place of the oldest where the buffer is full."""
        if not self.columns:
            if self.device.type == "cuda":
                each = sum(values[0].nbytes for values in crops.values())
                self.kept = int(KEPT_SHARE * torch.cuda.mem_get_info(self.device)[0] / each)
            self.columns = {
                name: values.new_zeros((self.kept, *values.shape[1:]), device=self.device)
                for name, values in crops.items()
            }
        count = len(crops["count"])
        at = torch.arange(self.made, self.made + count, device=self.device) % self.kept
        for name, values in crops.items():
            self.columns[name][at] = values.to(self.device, non_blocking=True)
        self.made += count

    def drawn(self, count: int) -> dict[str, Tensor]:
        """So many crops, drawn at random."""
        at = torch.randint(min(self.made, self.kept), (count,), device=self.device)
        return {name: values.index_select(0, at) for name, values in self.columns.items()}


def boxes_of(crops: Mapping[str, Tensor], each: int) -> dict[str, Tensor]:
    """So many boxes of each crop, drawn at random, row by row."""
    row = random_rows(crops["count"][:, None].expand(-1, each))
    which = torch.arange(len(row), device=row.device)[:, None]
    found = {
        name.removeprefix("of_box_"): values[which, row].flatten(0, 1)
        for name, values in crops.items()
        if name.startswith("of_box_")
    }
    return found | {"size": found["size"].clamp(min=1)}  # a crop may have none


def random_rows(counts: Tensor) -> Tensor:
    """A row below each count, at random, int64 of the shape of the counts; 0 below none."""
    row = (torch.rand(counts.shape, device=counts.device) * counts).long()
    return torch.minimum(row, counts.long() - 1).clamp(min=0)
