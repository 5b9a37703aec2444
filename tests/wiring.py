"""Does a test fail for every stage and model that is left out of the flow? Run by `make wiring`.

Bypassed one at a time are the stage functions that `pipeline/chains.py` and `pipeline/detectors.py` name, and the
models of `pipeline.models.model_files.Models` and their parts. A bypassed stage passes its items on undecided; a
bypassed model is absent or says nothing. The end-to-end tests of the preset then have to fail. The program names what
they do not notice, and its exit status is 1.
"""

import argparse
import json
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache, wraps
from hashlib import sha256
from multiprocessing.connection import wait
from pathlib import Path
from types import FunctionType, NoneType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from numpy.typing import NDArray

from wayside.pipeline import chains, cli, detectors, workers  # noqa: F401
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.models import model_files
from wayside.pipeline.models.model_json import digest, model_to_json
from wayside.pipeline.running import flow, run  # noqa: F401
from wayside.schemas.detections import Candidates, Detections, Segmentation
from wayside.schemas.frame import Frame, Image
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.models import NetworkSum, OnnxFile
from wayside.schemas.motion import PosedDetections
from wayside.schemas.roadside import CrossSection, Roadside
from wayside.schemas.signs import Sign
from wayside.stages.calibration import CalibrationWatch, DriveCalibration
from wayside.stages.detection import BOX_VALUES
from wayside.stages.georeference import DrivePath, PathPoint
from wayside.stages.georeference.path import drive_path
from wayside.stages.mapping.window import untracked
from wayside.stages.roadside.sweep import Sweep
from wayside.stages.segmentation import unsegmented

TESTS = Path(__file__).parent / "end_to_end"
PRESETS = ("default", "report", "report-shape", "report-2d")
NOT_BYPASSED = {"read", "queue"}
"""Names that the clock knows beside the stages: the source of the frames and the wait for the workers."""
BY_OPTION = {"detect_externally"}
"""Stages that no preset calls: `--detector` and `--detections` do."""
DRAWN = {("default", "location_classes")}
"""Models that decide nothing in a preset: the viewer draws them, which tests/pipeline/view/test_views.py sees."""
SURE = 5.0
"""Log odds that a classifier that tells nothing gives to everything."""
NEEDED = {"box_network", "front_scores"}
"""Models that preset `default` does not run without: one that tells nothing takes their place."""
CPU_LIMIT_S = 30
"""Several times what the tests of a preset need. Without a classifier, every region is followed, for minutes."""
CANNOT_CUT = 9
"""Exit status where this program does not know how to leave something out."""
NOTICED = (1, -signal.SIGKILL, -signal.SIGXCPU)
"""Exit statuses of tests that fail or do not come to an end."""


def _unplaced(landmark: Landmark) -> Sign:
    """The landmark as the first sign, in the axes of its camera."""
    position, covariance = landmark.position, landmark.covariance
    offset = landmark.station_m, landmark.right_m, landmark.above_m, np.nan
    size = landmark.width_m, landmark.height_m, landmark.sigma_width_m, landmark.sigma_height_m
    where = (position, covariance, position, covariance)
    return Sign(1, 1, landmark, "sign", 0.5, *where, *offset, *size, None)


DO_NOTHING: dict[tuple[type, type], Callable[[Any], Any]] = {
    (Frame, Image): lambda frame: Image(frame, None, None),
    (Image, Segmentation): unsegmented,
    (Segmentation, Detections): lambda found: Detections(found, Candidates.of(found.regions)),
    (Detections, PosedDetections): lambda found: PosedDetections(found, None),
    (PosedDetections, TrackedFrame): lambda posed: untracked(posed, posed.detections.candidates),
    (Landmark, Sign): _unplaced,
    (CalibrationWatch, DriveCalibration): lambda watch: None,
    (Sweep, CrossSection): lambda one: CrossSection(
        one.station_m, one.frame, np.nan, *np.zeros((4, 0)), (), np.zeros((0, 3)), (Roadside(),) * 2
    ),
}
"""What a stage from one type to another gives when it decides nothing; from a type to itself: the item."""
DO_NOTHING_WITH_ALL: dict[tuple[type, type], Callable[[list[Any]], Any]] = {
    (PathPoint, DrivePath): lambda points: drive_path(
        points, "drive_start", {point.frame: point.chained for point in points}
    )
}
"""The same of a stage that makes one item of all."""


def _uninformed(model: Any) -> object:
    """A model of that kind that says the same of everything."""
    if isinstance(model, OnnxFile):
        return _uninformed_boxes(Path(model.path))
    match model.kind:
        case "gaussian":
            first = model.classes[0]
            same = [
                replace(one, mean=first.mean, covariance=first.covariance) for one in model.classes
            ]
            return replace(model, classes=tuple(same), background=(), threshold=-np.inf)
        case "score":
            return replace(model, threshold=-SURE, with_network=NetworkSum(0.0, 0.0, 0.0))
        case "linear":
            return replace(model, weights=np.zeros_like(model.weights))
        case "evidence":
            level = tuple(np.zeros_like(curve) for curve in model.curves)
            return replace(model, curves=level, shift=SURE)
    raise TypeError(f"tests/wiring.py knows no model of kind {model.kind} that tells nothing")


@cache
def _uninformed_boxes(path: Path) -> OnnxFile:
    """The box network with a last layer that says the same of every box: it is the front of a panel."""
    content = path.read_bytes()
    bias = np.zeros(BOX_VALUES, np.float32)
    bias[0] = SURE
    for name, numbers in (("out.weight", None), ("out.bias", bias)):
        content = _with_numbers(content, name, numbers)
    written = Path(tempfile.mkdtemp()) / path.name
    written.write_bytes(content)
    return OnnxFile(str(written), sha256(content).hexdigest())


def _with_numbers(content: bytes, name: str, numbers: NDArray[np.float32] | None) -> bytes:
    """An ONNX file with other numbers, or zeros, in the tensor of that name: field 8, before them in field 9."""
    head = b"\x42" + bytes([len(name)]) + name.encode() + b"\x4a"
    at = content.index(head) + len(head)
    count, shift = 0, 0
    while True:  # how many bytes follow, seven bits at a time
        count |= (content[at] & 127) << shift
        shift, at = shift + 7, at + 1
        if content[at - 1] < 128:
            break
    new = bytes(count) if numbers is None else numbers.tobytes()
    if len(new) != count:
        raise ValueError(f"{name}: {count} bytes instead of {len(new)}")
    return content[:at] + new + content[at + count :]


@dataclass(frozen=True, slots=True)
class Cut:
    """One thing to leave out: `stage <function>` or `model <field>[.<part>...]`; nothing: the flow as it is."""

    preset: str
    kind: str = ""
    name: str = ""

    def __str__(self) -> str:
        """For the table."""
        return f"{self.preset}: {self.kind} {self.name}" if self.kind else f"{self.preset}: whole"


def stage_functions() -> dict[str, tuple[FunctionType, type, type]]:
    """The functions from iterator to iterator that chains and detectors import, with the types of their items."""
    found = {}
    for name, function in (vars(chains) | vars(detectors)).items():
        if not isinstance(function, FunctionType) or function.__module__ == workers.__name__:
            continue
        hints = get_type_hints(function)
        ends = [next(iter(hints.values()), None), hints.get("return")]
        if all(get_origin(end) is Iterator for end in ends):
            source, result = (get_args(end)[0] for end in ends)
            found[name] = (function, source, result)
    return found


def model_paths(models: object) -> list[str]:
    """Every model and part of one that is there."""
    paths = []
    for field in fields(models):  # type: ignore[arg-type]
        value = getattr(models, field.name)
        if is_dataclass(value) and (hasattr(value, "kind") or isinstance(value, OnnxFile)):
            paths.append(field.name)
            paths += [f"{field.name}.{rest}" for rest in model_paths(value)]
    return paths


def without_model(models: Any, path: str) -> Any:
    """The models without that one, or with one in its place that tells nothing."""
    name, _, rest = path.partition(".")
    value = getattr(models, name)
    if rest:
        return replace(models, **{name: without_model(value, rest)})
    optional = NoneType in get_args(get_type_hints(type(models))[name]) and name not in NEEDED
    return replace(models, **{name: None if optional else _uninformed(value)})


def shipped(preset: str) -> model_files.Models:
    """The models of a preset."""
    settings, _ = load_settings(preset, None, [], {"roadside.on": True})
    return model_files.load_models(settings)


def cut_stage(name: str) -> None:
    """Bypass a stage function of the flow in this process."""
    function, source, result = stage_functions()[name]
    step = DO_NOTHING.get((source, result))
    whole = DO_NOTHING_WITH_ALL.get((source, result))
    if source is not result and step is None and whole is None:
        raise ValueError(
            f"stage {name}: tests/wiring.py does not know what a stage from {source.__name__} to "
            f"{result.__name__} gives when it decides nothing; add that to DO_NOTHING"
        )

    @wraps(function)
    def bypass(items: Iterator[Any], *_: Any, **__: Any) -> Iterator[Any]:
        if whole is not None:
            yield whole(list(items))
        else:
            yield from items if step is None else map(step, items)

    for module in (chains, detectors):
        if hasattr(module, name):
            setattr(module, name, bypass)


def cut_model(path: str) -> None:
    """Leave a model out of every flow that this process makes."""
    make = flow.Flow.__init__

    def without(self: Any, *args: Any, **named: Any) -> None:
        def cut(value: Any) -> Any:
            return without_model(value, path) if isinstance(value, model_files.Models) else value

        make(self, *map(cut, args), **{name: cut(value) for name, value in named.items()})

    flow.Flow.__init__ = without  # type: ignore[method-assign]


def note_stages(file: Path) -> None:
    """Write down which function works under which name of the clock, for all flows of this process."""
    seen: dict[str, str] = {}

    def note(method: Any) -> Any:
        def noted(self: Any, name: str, items: Any) -> Any:
            if name not in NOT_BYPASSED:
                seen[name] = getattr(items, "__name__", type(items).__name__)
                file.write_text(json.dumps(seen))
            return method(self, name, items)

        return noted

    clock: Any = workers.StageClock
    clock.timed, clock.timed_drive = note(clock.timed), note(clock.timed_drive)


def attempt(cut: Cut, folder: Path) -> None:
    """Run the tests of the preset on the cut flow; leaves with pytest's exit status."""
    try:
        if cut.kind == "stage":
            cut_stage(cut.name)
        elif cut.kind == "model":
            # a fault of this shall not look like a failing test
            without_model(shipped(cut.preset), cut.name)
            cut_model(cut.name)
        else:
            note_stages(folder / f"{cut.preset}.json")
    except Exception:
        traceback.print_exc()
        os._exit(CANNOT_CUT)
    longer = [f"not {preset}" for preset in PRESETS if preset.startswith(f"{cut.preset}-")]
    own = " and ".join([cut.preset, *longer])
    options = ["-x", "-q", "-p", "no:cacheprovider", "-k", own, str(TESTS)]
    if cut.kind:  # the whole flow may have to compile its kernels first
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S))
    words = folder / f"{os.getpid()}.txt"
    with words.open("w") as out, redirect_stdout(out), redirect_stderr(out):
        status = pytest.main([*options, "--ignore", str(TESTS / "test_command_line.py")])
    if status not in (0, 1):
        print(words.read_text(), file=sys.stderr, flush=True)
    os._exit(int(status))


def try_all(cuts: list[Cut], folder: Path, jobs: int) -> dict[Cut, int]:
    """Exit status of the tests for each cut; so many processes side by side."""
    fork = multiprocessing.get_context("fork")
    waiting, running, statuses = list(cuts), {}, {}
    while waiting or running:
        while waiting and len(running) < jobs:
            cut = waiting.pop(0)
            process = fork.Process(target=attempt, args=(cut, folder))
            process.start()
            running[process.sentinel] = (cut, process, time.monotonic())
        for sentinel in wait(list(running)):
            cut, process, started = running.pop(sentinel)
            process.join()
            status = statuses[cut] = process.exitcode
            words = "noticed" if status in NOTICED else f"passes ({status})"
            print(f"{cut!s:45} {words:10} {time.monotonic() - started:5.1f} s", flush=True)
    return statuses


def cuts_of(preset: str, calls: dict[str, str], known: set[str]) -> tuple[list[Cut], list[str]]:
    """What to leave out of a preset, and which of its stages have no function to bypass.

    known: functions, and digests of models, that are left out in another preset already; those of this one join them.
    """
    functions = stage_functions()
    names = {function.__name__: name for name, (function, *_) in functions.items()}
    new = sorted({call for call in calls.values() if call in names} - known)
    stages = [Cut(preset, "stage", names[call]) for call in new]
    unknown = [
        f"{preset}: stage {name} ({call})" for name, call in calls.items() if call not in names
    ]
    models = shipped(preset)
    asked = [path for path in model_paths(models) if (preset, path) not in DRAWN]
    held = {path: getattr(models, path) for path in asked if "." not in path}
    digests = {
        path: one.sha256 if isinstance(one, OnnxFile) else digest(model_to_json(one))
        for path, one in held.items()
    }
    paths = [path for path in asked if digests[path.split(".")[0]] not in known]
    known |= {*digests.values(), *calls.values()}
    return stages + [Cut(preset, "model", path) for path in paths], unknown


def main() -> int:
    """Leave everything out, one at a time, and say what no test noticed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side")
    parser.add_argument("--only", default="", help="part of the name of what to leave out")
    asked = parser.parse_args()
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        whole = try_all([Cut(preset) for preset in PRESETS], folder, asked.jobs)
        if any(whole.values()):
            print("the end-to-end tests fail as it is; see `make test`", file=sys.stderr)
            return 1
        cuts: list[Cut] = []
        faults: list[str] = []
        called: set[str] = set()
        known: set[str] = set()
        for preset in PRESETS:
            calls = json.loads((folder / f"{preset}.json").read_text())
            called |= set(calls.values())
            more, unknown = cuts_of(preset, calls, known)
            cuts += more
            faults += [f"{one}: has no function from iterator to iterator" for one in unknown]
        for name, (function, *_) in stage_functions().items():
            if function.__name__ not in called | BY_OPTION:
                faults.append(f"stage {name}: no preset calls it")
        cuts = [cut for cut in cuts if asked.only in str(cut)]
        statuses = try_all(cuts, folder, asked.jobs)
    for cut, status in statuses.items():
        if status not in NOTICED:
            faults.append(f"{cut}: left out, and no test fails (exit status {status})")
    took = time.monotonic() - started
    print(f"{len(cuts)} stages and models left out, {len(faults)} faults, {took:.0f} s")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
