"""The last crops that were made, with their boxes, on the device that learns from them."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

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
