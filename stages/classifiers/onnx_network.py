"""Networks of ONNX files, run by onnxruntime."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PROVIDERS = ("CUDAExecutionProvider", "CPUExecutionProvider")
"""What networks can run on, best first. All processors give the same bytes; a graphics card gives others."""


@dataclass(frozen=True, slots=True)
class NetworkInput:
    """An input of a network: its type as onnxruntime writes it, and its shape, 0 where a side is not fixed."""

    name: str
    type: str
    shape: tuple[int, ...]


class OnnxNetwork:
    """A network of an ONNX file, run by onnxruntime in the thread that asks; threads may share it.

    `file`: its path or content. `outputs`: names of those to compute; all if empty.
    Raises ValueError where the file cannot be run.
    """

    def __init__(self, file: str | bytes, outputs: tuple[str, ...] = ()) -> None:
        try:
            content = file if isinstance(file, bytes) else Path(file).read_bytes()
            self._session = _session(file, sha256(content).hexdigest())
        except Exception as error:  # the engine has a class of its own for each fault of a file
            raise ValueError(str(error)) from error
        self.outputs = outputs or tuple(one.name for one in self._session.get_outputs())
        self.inputs = tuple(
            NetworkInput(one.name, one.type, tuple(_fixed(side) for side in one.shape))
            for one in self._session.get_inputs()
        )
        self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map

    def run(self, inputs: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Outputs by name, integers of 8 bits as they are, other numbers as float32.

        Raises ValueError where the inputs are none that the network takes, or the outputs no numbers.
        """
        try:
            values = self._session.run(list(self.outputs), dict(inputs))
            return {
                name: np.asarray(value, np.uint8 if value.dtype == np.uint8 else np.float32)
                for name, value in zip(self.outputs, values, strict=True)
            }
        except Exception as error:  # outputs that are no arrays of numbers, too
            raise ValueError(str(error)) from error


def providers() -> list[str]:
    """Those of `PROVIDERS` that onnxruntime has here, best first."""
    import onnxruntime

    return [name for name in PROVIDERS if name in onnxruntime.get_available_providers()]


@lru_cache(maxsize=4)
def _session(file: str | bytes, content: str) -> Any:
    """A network of a file of this `content` (SHA-256): whoever names the file shares it, as opening takes 0.04 s."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3  # only errors are written to the terminal
    return onnxruntime.InferenceSession(file, options, providers=providers())


def _fixed(side: int | str | None) -> int:
    return max(side, 0) if isinstance(side, int) else 0
