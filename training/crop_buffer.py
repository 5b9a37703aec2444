"""The last crops that were made, on the device that learns from them, and patches of their boxes."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from training.detector_crops import CROP_PX
from wayside.stages.detection import INNER, SIDE

KEPT, KEPT_SHARE = 8_000, 0.6
"""Crops of 0.23 MB that a processor keeps; an accelerator keeps what fills this fraction of its free memory."""


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

    def boxes(self, crops: Mapping[str, Tensor], each: int) -> dict[str, Tensor]:
        """So many boxes of each crop, drawn at random, with their patches and targets, row by row."""
        row = random_rows(crops["count"][:, None].expand(-1, each))
        which = torch.arange(len(row), device=row.device)[:, None]
        drawn = {
            name.removeprefix("of_box_"): values[which, row]
            for name, values in crops.items()
            if name.startswith("of_box_")
        }
        patch = patches_of(crops["rgb"], drawn["box"])
        found = {name: values.flatten(0, 1) for name, values in (drawn | {"patch": patch}).items()}
        return found | {"size": (found["box"][:, 2:] - found["box"][:, :2]).clamp(min=1)}


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
