"""Bytes and JSON changed at random (used by mutations.py)."""

from __future__ import annotations

import json
import math
import random
from copy import deepcopy
from typing import Any


def changed_bytes(content: bytes, rng: random.Random) -> bytes:
    """One to six edits: bits flipped, runs set, cut out, inserted or doubled."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 6)):
        at, run = rng.randrange(len(data)), rng.choice((1, 1, 4, 8, rng.randrange(1, 400)))
        edit = rng.randrange(6)
        if edit == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif edit == 1:
            data[at : at + run] = bytes([rng.choice((0, 255, rng.randrange(256)))]) * run
        elif edit == 2:
            del data[at : at + run]
        elif edit == 3:
            data[at:at] = rng.randbytes(run)
        elif edit == 4:
            data[at:at] = data[at : at + run]
        else:
            data[at : at + 8] = rng.choice((0, 2**31, 2**40, 2**63, 45)).to_bytes(8, "little")
        if len(data) < 2:
            return bytes(data)
    return bytes(data)


ODD: tuple[Any, ...] = (
    None, True, -1, 0, 2**31, 2**64, -(2**40), 1e-300, 1e300, math.nan, math.inf,
    "", "x", "../..", "\0", [], {}, [[]], [1],
)  # fmt: skip


def changed_tree(value: Any, rng: random.Random) -> Any:
    """JSON with one to four values replaced, removed, repeated or exchanged for odd ones."""
    value = json.loads(json.dumps(value))
    for _ in range(rng.randint(1, 4)):
        holder, key = value, None
        for _ in range(rng.randrange(1, 9)):
            keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
            if not keys:
                break
            key = rng.choice(keys)
            if not isinstance(holder[key], (dict, list)) or not holder[key]:
                break
            if rng.random() < 0.8:
                holder, key = holder[key], None
        if (
            key is None
            or (isinstance(holder, list) and key >= len(holder))
            or key not in (holder if isinstance(holder, dict) else range(len(holder)))
        ):
            continue
        edit = rng.randrange(4)
        if edit == 0:
            del holder[key]
        elif edit == 1 and isinstance(holder, list):
            holder.insert(key, deepcopy(holder[key]))
        else:
            holder[key] = deepcopy(rng.choice(ODD))
    return value
