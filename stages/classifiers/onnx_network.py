"""Networks of ONNX files, run by onnxruntime."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

ERRORS = 3
"""Severity from which onnxruntime writes to the terminal."""


class OnnxNetwork:
    """A network of an ONNX file, run by onnxruntime in the thread that asks; threads may share it.

    outputs: that are wanted, by name; all of the file where none are named. Raises ValueError where the file is none
    that can be run.
    """

    def __init__(self, path: str, outputs: tuple[str, ...] = ()) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = ERRORS
        try:
            self._session = onnxruntime.InferenceSession(
                path, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # the engine has a class of its own for each fault of a file
            raise ValueError(str(error)) from error
        self._outputs = outputs or tuple(one.name for one in self._session.get_outputs())
        self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map

    def run(self, inputs: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Outputs by name, integers of 8 bits as they are, other numbers as float32.

        Raises ValueError where the inputs are none that the network takes, or the outputs no numbers.
        """
        try:
            values = self._session.run(list(self._outputs), dict(inputs))
            return {
                name: np.asarray(value, np.uint8 if value.dtype == np.uint8 else np.float32)
                for name, value in zip(self._outputs, values, strict=True)
            }
        except Exception as error:  # outputs that are no arrays of numbers, too
            raise ValueError(str(error)) from error
