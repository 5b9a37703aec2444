"""A detector of the user's: its ONNX file is read, run once, and its format recognised, before a log is opened."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.class_map import numbered, read_class_map
from wayside.pipeline.input_files import read_input
from wayside.pipeline.json_text import CONTENT_FAULTS
from wayside.pipeline.onnx_header import FLOAT32, OnnxHeader, OnnxInput, read_onnx_header
from wayside.schemas.detectors import DetectorFile
from wayside.schemas.errors import InputError
from wayside.schemas.models import OnnxFile
from wayside.schemas.settings import ModelSettings
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.detection import multiple_of, recognised

SIZE_INPUT = "orig_target_sizes"
"""Second input of the networks that give pixels of the image: its width and height."""
FREE_SIZE = (640, 640)
"""On which a network of free input size is tried."""
MOST_PIXELS = 1 << 26
"""Of an input: eight times those of a camera of 8 megapixels."""
ADVICE = "see docs/detectors.md for the formats that are understood"


def load_detector(settings: ModelSettings) -> DetectorFile:
    """The detector that `models.detector` names, checked by one run on a grey image.

    Raises
    ------
    InputError
        The file is none that can be run, or its inputs or outputs are not understood; or the class map is wrong.
    """
    path = Path(settings.detector)
    try:
        data = read_input(path)
        header = read_onnx_header(data)
    except (OSError, ValueError) as error:
        raise _refusal(
            path, "an ONNX file", str(error), "export the detector as ONNX, or correct the path"
        ) from error
    task = header.metadata.get("task", "detect")
    if task != "detect":
        raise _refusal(path, "a detector", f"a network for the task {task!r}", ADVICE)
    image, size_input = _inputs(path, header)
    input_size = _input_size(path, image)
    names = _names(header)
    outputs = _first_run(path, header, image, size_input, input_size or FREE_SIZE)
    form = settings.detector_format
    if form == "auto":
        head = header.metadata.get("head", "") or header.metadata.get("description", "")
        try:
            form = recognised(outputs, input_size or FREE_SIZE, head, len(names))
        except ValueError as error:
            raise _refusal(
                path,
                "outputs of the YOLO or RT-DETR family",
                str(error),
                f"{ADVICE}, or name one with --set models.detector_format",
            ) from error
    signs = None
    if settings.classes:
        classes = read_class_map(Path(settings.classes))
        signs = numbered(classes, names, str(path), complete=True)
    return DetectorFile(
        OnnxFile(str(path), sha256(data).hexdigest()),
        form,
        input_size,
        image.name,
        size_input,
        header.outputs,
        signs,
    )


def _inputs(path: Path, header: OnnxHeader) -> tuple[OnnxInput, str]:
    """The input for the image, and the name of that for its size (empty: there is none)."""
    images = [one for one in header.inputs if len(one.shape) == 4]
    others = [one.name for one in header.inputs if len(one.shape) != 4]
    if len(images) != 1 or others not in ([], [SIZE_INPUT]):
        listed = ", ".join(f"{one.name} {list(one.shape)}" for one in header.inputs)
        raise _refusal(
            path, f"one image as input (and {SIZE_INPUT} at most)", f"the inputs {listed}", ADVICE
        )
    image = images[0]
    batch, channels = image.shape[:2]
    if batch > 1 or channels not in (0, 3) or image.element != FLOAT32:
        kind = "float32" if image.element == FLOAT32 else f"element type {image.element}"
        raise _refusal(
            path,
            "an input of one RGB image, float32 [1, 3, height, width]",
            f"{kind} {list(image.shape)}",
            "export it with a batch of 1, in single precision",
        )
    return image, others[0] if others else ""


def _input_size(path: Path, image: OnnxInput) -> tuple[int, int] | None:
    height, width = image.shape[2:]
    if height * width > MOST_PIXELS:
        raise _refusal(
            path,
            f"an input of at most {MOST_PIXELS} pixels",
            f"{width} x {height}",
            "export it for the size of your images",
        )
    if bool(height) != bool(width):
        raise _refusal(
            path,
            "an input whose height and width are both fixed or both free",
            str(list(image.shape)),
            "export it with a fixed size",
        )
    return (height, width) if height else None


def _names(header: OnnxHeader) -> dict[int, str]:
    """Names of the classes by number, as Ultralytics writes them; empty where there are none."""
    try:
        names: Any = ast.literal_eval(header.metadata.get("names", "{}"))
        listed = names.items() if isinstance(names, Mapping) else enumerate(names)
        return {int(number): str(name) for number, name in listed}
    except (*CONTENT_FAULTS, SyntaxError, MemoryError, RecursionError):  # both of deep nesting
        return {}


def _first_run(
    path: Path,
    header: OnnxHeader,
    image: OnnxInput,
    size_input: str,
    size: tuple[int, int],
) -> dict[str, NDArray[np.float32]]:
    """The outputs on a grey image."""
    height, width = multiple_of(size) if not image.shape[2] else size
    inputs: dict[str, NDArray[Any]] = {image.name: np.full((1, 3, height, width), 0.5, np.float32)}
    if size_input:
        inputs[size_input] = np.array([[width, height]], np.int64)
    try:
        return OnnxNetwork(str(path), header.outputs).run(inputs)
    except ValueError as error:
        words = " ".join(str(error).split())[:200]
        raise _refusal(path, "a network that can be run", words, ADVICE) from error


def _refusal(path: Path, wanted: str, found: str, advice: str) -> InputError:
    return InputError(f"models.detector: wanted {wanted} at {path}, found {found}; {advice}")
