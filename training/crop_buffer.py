"""The last crops that were made, on the device that learns from them, and patches of their boxes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wayside.pipeline.learning.crop_processes import COLUMNS
from wayside.pipeline.learning.detector_crops import CROP_PX
from wayside.stages.detection import INNER, SIDE


class CropBuffer:
    """Crops by column, those of images held out behind the others; kept: most of either."""

    def __init__(self, device: torch.device, kept: tuple[int, int]) -> None:
        self.kept = kept
        self.columns = {
            name: torch.zeros(
                (sum(kept), *shape), dtype=torch.from_numpy(np.zeros(1, kind)).dtype, device=device
            )
            for name, (kind, shape) in COLUMNS.items()
            if name != "held_out"
        }
        self.made = [0, 0]
        self._counts = torch.zeros(2, device=device)

    def add(self, crops: Mapping[str, Tensor], held_out: NDArray[np.bool_]) -> None:
        """Add crops (n, ...) by column, in place of the oldest where the buffer is full; held_out (n,)."""
        place = np.zeros(len(held_out), np.int64)
        for part, (first, kept) in enumerate(zip((0, self.kept[0]), self.kept, strict=True)):
            rows = np.flatnonzero(held_out == part)
            place[rows] = first + (self.made[part] + np.arange(len(rows))) % kept
            self.made[part] += len(rows)
            self._counts[part] = min(self.made[part], kept)
        at = torch.from_numpy(place).to(self._counts.device)
        for name, values in crops.items():
            self.columns[name].index_copy_(0, at, values)

    def drawn(self, share_held_out: float, count: int) -> dict[str, Tensor]:
        """So many crops, drawn at random; the share of them that come from images held out."""
        device = self._counts.device
        part = (torch.rand(count, device=device) < share_held_out).long()
        at = random_rows(self._counts[part]) + part * self.kept[0]
        return {name: values.index_select(0, at) for name, values in self.columns.items()}


def random_rows(counts: Tensor) -> Tensor:
    """A row below each count, at random, int64 of the shape of the counts; 0 below none."""
    row = (torch.rand(counts.shape, device=counts.device) * counts).long()
    return torch.minimum(row, counts.long() - 1).clamp(min=0)


def patches_of(rgb: Tensor, box: Tensor) -> Tensor:
    """Patches (n, k, side, side, 3), levels 0 to 255, of boxes (n, k, 4) of crops (n, `CROP_PX`, `CROP_PX`, 3).

    What `stages.detection.drawn_patches` does, in floating point on any device.
    """
    n, k = box.shape[:2]
    level = rgb.permute(0, 3, 1, 2).float()
    low, high = box[..., :2], box[..., 2:]
    longest = (high - low).amax(-1) / INNER
    steps = torch.arange(SIDE, device=rgb.device) - (SIDE - 1) / 2
    patches = torch.zeros((n, k, SIDE, SIDE, 3), device=rgb.device)
    for scale in (1, 2, 4):
        if scale > 1:
            level = torch.floor(nn.functional.avg_pool2d(level, 2) + 0.5)
        middle = ((low + high) / scale - 1) / 2
        apart = (high - low) / (INNER * scale)
        at = middle[..., None, :] + apart[..., None, :] * steps[:, None]
        last = CROP_PX // scale - 1
        at = at.clamp(0, last) * (2 / last) - 1  # (n, k, side, 2), -1 to 1
        x = at[..., 0][:, :, None, :].expand(n, k, SIDE, SIDE)
        y = at[..., 1][:, :, :, None].expand(n, k, SIDE, SIDE)
        grid = torch.stack([x, y], -1).reshape(n, k * SIDE, SIDE, 2)
        seen = nn.functional.grid_sample(level, grid, padding_mode="border", align_corners=True)
        seen = seen.reshape(n, 3, k, SIDE, SIDE).permute(0, 2, 3, 4, 1)
        # a box is sampled from the size that is nearest above that of its patch
        smaller = longest >= (scale if scale > 1 else 0)
        patches = torch.where(smaller[..., None, None, None], seen, patches)
    return patches.floor()
