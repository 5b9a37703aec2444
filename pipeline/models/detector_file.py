"""A detector of the user's: its ONNX file is read, run once, and its format recognised, before a log is opened."""

import ast
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.files.input_files import read_input
from wayside.pipeline.files.parsing import CONTENT_FAULTS
from wayside.pipeline.labels.class_map import numbered, read_class_map
from wayside.schemas.detectors import DetectorFile
from wayside.schemas.errors import InputError
from wayside.schemas.models import OnnxFile
from wayside.schemas.settings import ModelSettings
from wayside.stages.classifiers import NetworkInput, OnnxNetwork
from wayside.stages.detection import recognised

FLOAT32 = "tensor(float)"
"""Type of an input of single precision."""
SIZE_INPUT = "orig_target_sizes"
"""Second input of the networks that give pixels of the image: its width and height."""
FREE_SIZE = (640, 640)
"""On which a network of free input size is tried."""
MOST_PIXELS = 1 << 26
"""Of an input: eight times those of a camera of 8 megapixels."""
ADVICE = "See docs/detectors.md for the formats."


def load_detector(settings: ModelSettings) -> DetectorFile:
    """The detector that `models.detector` names, checked by one run on a grey image.

    Raises InputError where the file cannot be run, its inputs or outputs are unknown, or the class map is wrong.
    """
    path = Path(settings.detector)
    try:
        data = read_input(path)
        network = OnnxNetwork(str(path))
    except (OSError, ValueError) as error:
        advice = "Export the detector as ONNX, or correct the path."
        raise _refusal(path, f"is not an ONNX file: {_words(error)}", advice) from error
    task = network.metadata.get("task", "detect")
    if task != "detect":
        raise _refusal(path, f"is not a detector but a network for the task {task!r}")
    image, size_input = _inputs(path, network)
    height, width = image.shape[2:]
    input_size = (height, width) if height else None
    tried, names = input_size or FREE_SIZE, _names(network)
    grey: dict[str, NDArray[Any]] = {image.name: np.full((1, 3, *tried), 0.5, np.float32)}
    if size_input:
        grey[size_input] = np.array([tried[::-1]], np.int64)
    try:
        outputs = network.run(grey)
    except ValueError as error:
        raise _refusal(path, f"cannot be run: {_words(error)}") from error
    form = settings.detector_format
    if form == "auto":
        head = network.metadata.get("head", "") or network.metadata.get("description", "")
        try:
            form = recognised(outputs, tried, head, len(names))
        except ValueError as error:
            raise _refusal(
                path,
                f"does not have the outputs of the YOLO or RT-DETR family: {error}",
                f"{ADVICE} Name one with --set models.detector_format.",
            ) from error
    signs = None
    if settings.classes:
        signs = numbered(read_class_map(Path(settings.classes)), names, str(path), complete=True)
    onnx = OnnxFile(str(path), sha256(data).hexdigest())
    return DetectorFile(onnx, form, input_size, image.name, size_input, network.outputs, signs)


def _inputs(path: Path, network: OnnxNetwork) -> tuple[NetworkInput, str]:
    """The input for the image, and the name of the input for its size, or an empty name."""
    images = [one for one in network.inputs if len(one.shape) == 4]
    others = [one.name for one in network.inputs if len(one.shape) != 4]
    if len(images) != 1 or others not in ([], [SIZE_INPUT]):
        listed = ", ".join(f"{one.name} {list(one.shape)}" for one in network.inputs)
        fault = f"has the inputs {listed} instead of one image (and {SIZE_INPUT} at most)"
        raise _refusal(path, fault)
    (image,) = images
    batch, channels, height, width = image.shape
    kind = "float32" if image.type == FLOAT32 else image.type
    if batch > 1 or channels not in (0, 3) or kind != "float32":
        fault = f"has an input {kind} {list(image.shape)} instead of one RGB image, float32 [1, 3, height, width]"
        raise _refusal(path, fault, "Export it with a batch of 1, in single precision.")
    if height * width > MOST_PIXELS:
        fault = f"has an input of {width} x {height}, more than {MOST_PIXELS} pixels"
        raise _refusal(path, fault, "Export it for the size of your images.")
    if bool(height) != bool(width):
        fault = f"has an input {list(image.shape)}, where height and width must both be fixed or both free"
        raise _refusal(path, fault, "Export it with a fixed size.")
    return image, others[0] if others else ""


def _names(network: OnnxNetwork) -> dict[int, str]:
    """Names of the classes by number, as Ultralytics writes them; empty where there are none."""
    try:
        names: Any = ast.literal_eval(network.metadata.get("names", "{}"))
        listed = names.items() if isinstance(names, Mapping) else enumerate(names)
        return {int(number): str(name) for number, name in listed}
    except (*CONTENT_FAULTS, SyntaxError, MemoryError, RecursionError):  # both of deep nesting
        return {}


def _refusal(path: Path, fault: str, advice: str = ADVICE) -> InputError:
    return InputError(f"models.detector: {path} {fault}. {advice}")


def _words(error: Exception) -> str:
    """What an error says, in one line."""
    return " ".join(str(error).split())[:200]
