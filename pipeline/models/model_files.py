"""The models of a run: those that ship with wayside, or a folder of the user's own files."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scipy.special import expit, logit

from wayside.pipeline.labels.box_file import load_boxes
from wayside.pipeline.models.detector_file import load_detector
from wayside.pipeline.models.model_folder import ModelFolder, shipped_models
from wayside.pipeline.models.model_json import digest, model_to_json
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.detectors import BoxFile, DetectorFile
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.landmarks import EVIDENCE_TERMS
from wayside.schemas.models import (
    EvidenceModel,
    GaussianModel,
    LinearModel,
    MixtureModel,
    OnnxFile,
    ScoreModel,
)
from wayside.schemas.settings import Settings
from wayside.stages.classifiers import OnnxNetwork, at_alpha
from wayside.stages.detection import BoxNetwork, DetectionNetwork
from wayside.stages.mapping import FEATURES as LANDMARK_FEATURES
from wayside.stages.panel import OUTLINE_FEATURES, POST_FEATURES
from wayside.stages.report import COLOR_SPACES, DESCRIPTORS
from wayside.stages.sign_codes import CLASSES, FaceClassifier

REPORT_LOCATION, PANEL_SIZE = "location_report.json", "panel_size.json"
TRAJECTORY_FILES = {"image": "trajectory.json", "compensated": "trajectory_compensated.json"}
"""Density of the trajectories of signs, by its form."""
OWN_COLORS = "color.json"
"""Colours that `wayside fit` writes: their space need not be RGB."""
_NAMES = {
    "color_classes": "color",
    "shape_classes": "shape",
    "location_classes": "location",
    "outline_weights": "outline",
    "landmark_classifier": "place",
    "front_scores": "front",
    "back_scores": "back",
    "back_landmark_classifier": "back_place",
    "trajectory_density": "trajectory",
    "panel_sizes": "panel_size",
    "detection_network": "network",
    "box_network": "box",
    "face_network": "face_code",
    "post_kinds": "post",
}
"""The name that `run.json` and messages use for each model."""


@dataclass(frozen=True, slots=True)
class Models:
    """Everything learned that a run uses; None where there is no such file, or the preset needs none."""

    location_classes: GaussianModel
    """Where signs stand."""
    outline_weights: LinearModel
    """Which of several concentric outlines of a panel is the outer one."""
    color_classes: GaussianModel | None = None
    """The report's classes of the mean colour of a region."""
    shape_classes: GaussianModel | None = None
    """The report's classes of the outline of a region."""
    landmark_classifier: EvidenceModel | None = None
    """Of a landmark by all its observations."""
    back_landmark_classifier: EvidenceModel | None = None
    """The same of panels seen from behind."""
    front_scores: ScoreModel | None = None
    """Which scores of the box network are accepted."""
    back_scores: ScoreModel | None = None
    """The same of panels seen from behind."""
    box_network: OnnxFile | None = None
    """Classifies boxes, moves them onto panels, names their colour and shape."""
    detection_network: OnnxFile | None = None
    """Finds the boxes that are classified."""
    external: DetectorFile | BoxFile | None = None
    """Another detector, or its boxes, in the place of wayside's own."""
    trajectory_density: MixtureModel | None = None
    """Of the motion of signs in the image."""
    panel_sizes: GaussianModel | None = None
    """Logarithms of width and height, metres, of the segments of signs and of other things."""
    face_network: OnnxFile | None = None
    """What sign a face shows."""
    post_kinds: LinearModel | None = None
    """What the posts of signs are; only where the roadside is asked for."""

    def sign_confidence(self, setting: float) -> float:
        """Confidence from which a face counts as a sign: `setting`, its log odds counted from the model's decision.

        What another detector let through is a sign: its scores are no probabilities.
        """
        if self.external is not None:
            return 0.0
        decision = 0.0 if self.landmark_classifier is None else self.landmark_classifier.decision
        return float(expit(logit(setting) + decision)) if decision else setting

    def digests(self) -> dict[str, str]:
        """SHA-256 of each model's file, by its name; of the text it would have where settings changed the model."""
        digests = {}
        for name, model in self._named().items():
            own = model.sha256 if isinstance(model, OnnxFile) else model.text_digest
            digests[name] = own or digest(model_to_json(model))
        if isinstance(self.external, DetectorFile):
            digests["detector"] = self.external.onnx.sha256
        elif self.external is not None:
            digests["detections"] = self.external.sha256
        return digests

    def provenances(self) -> dict[str, str]:
        """The stated provenance of each model, by its name."""
        said = {}
        for name, model in self._named().items():
            if isinstance(model, OnnxFile):
                metadata = onnx_metadata(model.path)
                said[name] = "; ".join(text for key, text in metadata.items() if key != CLASSES)
            else:
                said[name] = model.provenance
        return said

    def _named(self) -> dict[str, Any]:
        named = {name: getattr(self, column) for column, name in _NAMES.items()}
        return {name: model for name, model in named.items() if model is not None}


def learned_from(log: str, provenances: Mapping[str, str]) -> tuple[str, ...]:
    """Names of the models whose provenance lists a log among its sources.

    A log is listed by the stem of its file name, maybe behind a folder and a slash, and followed by how much it gave:
    `drive (60 images, ...` or `drive: 42 images`.
    """
    source = re.compile(rf"(?<![^\s/;,]){re.escape(log)}(?: \(|: )\d")
    return tuple(name for name, text in provenances.items() if source.search(text))


def onnx_metadata(file: str | bytes) -> dict[str, str]:
    """Metadata of a network by its ONNX file or the content of it; none where it is not one."""
    try:
        return dict(OnnxNetwork(file).metadata)
    except ValueError:
        return {}


def load_models(settings: Settings) -> Models:
    """The models that the settings ask for, each of the folder `models.folder` where it is there, else as it ships.

    Raises InputError where the folder or a file of it cannot be used.
    """
    folder = ModelFolder.of(settings.models.folder)
    models = (_report_models if settings.report.on else _default_models)(folder, settings)
    _check_inputs(models, folder)
    folder.require_used()
    return _at_alpha(models, settings) if settings.models.alpha else models


def _default_models(folder: ModelFolder, settings: Settings) -> Models:
    """The networks of preset `default`, or another detector in their place."""
    external = _external(settings)
    network = settings.models.network
    return Models(
        _location(folder, settings.models.location or "location.json"),
        folder.read("outline.json", LinearModel),
        landmark_classifier=folder.find("place.json", EvidenceModel),
        back_landmark_classifier=folder.find("back_place.json", EvidenceModel),
        front_scores=folder.read("front.json", ScoreModel),
        back_scores=folder.find("back.json", ScoreModel),
        box_network=folder.network("box.onnx", BoxNetwork),
        detection_network=(
            None if external else folder.network(network, DetectionNetwork, "models.network")
        ),
        external=external,
        face_network=folder.network("face_code.onnx", FaceClassifier),
        post_kinds=folder.read("post.json", LinearModel) if settings.roadside.on else None,
    )


def _report_models(folder: ModelFolder, settings: Settings) -> Models:
    """The gates of the report's chain; colours of the user's own may be of any space, those that ship are of RGB."""
    colors = OWN_COLORS if folder.own_file(OWN_COLORS) else "color_rgb.json"
    moves = TRAJECTORY_FILES.get(settings.report.trajectory)
    return Models(
        _location(folder, settings.models.location or REPORT_LOCATION),
        folder.read("outline.json", LinearModel),
        color_classes=folder.read(colors, GaussianModel),
        shape_classes=folder.read("shape.json", GaussianModel) if settings.report.shape else None,
        trajectory_density=folder.read(moves, MixtureModel) if moves else None,
        panel_sizes=folder.read(PANEL_SIZE, GaussianModel),
    )


def _external(settings: Settings) -> DetectorFile | BoxFile | None:
    if settings.models.detector:
        return load_detector(settings.models)
    return load_boxes(settings) if settings.models.detections else None


def _location(folder: ModelFolder, name: str) -> GaussianModel:
    """The location model of the preset, at a path, or one that ships by its name."""
    path, shipped = Path(name), f"{Path(name).stem}.json"
    if name == shipped and folder.holds(name):
        return folder.read(name, GaussianModel)
    if path.is_file():
        return ModelFolder(path.parent).read(path.name, GaussianModel)
    if not (shipped_models() / shipped).is_file():
        raise InputError(
            f"models.location: there is no model file at {name}. Correct the path, name report-kansas, or leave "
            "the setting out."
        )
    return ModelFolder().read(shipped, GaussianModel)


def _check_inputs(models: Models, folder: ModelFolder) -> None:
    """Refuse models of other inputs than those that the stages compute, before the first image."""
    known = {*LANDMARK_FEATURES, *EVIDENCE_TERMS}
    odd = {"outline.json": {*models.outline_weights.features} ^ {*OUTLINE_FEATURES}}
    places = models.landmark_classifier, models.back_landmark_classifier
    for name, evidence in zip(("place.json", "back_place.json"), places, strict=True):
        if evidence is not None:
            odd[name] = {*evidence.features, *evidence.terms} - known
    if models.color_classes is not None:
        _check_gate(models.color_classes, COLORS, COLOR_SPACES)
        _check_gate(models.location_classes, None, {"right_up_m": 2})
    if models.shape_classes is not None:
        _check_gate(models.shape_classes, SHAPES, {"fourier8": DESCRIPTORS})
    if models.panel_sizes is not None:
        odd[PANEL_SIZE] = {models.panel_sizes.space} ^ {"log_m"}
    if models.post_kinds is not None:
        odd["post.json"] = {*models.post_kinds.features} ^ {*POST_FEATURES}
    for name, inputs in odd.items():
        if inputs:
            raise InputError(
                f"{folder.file(name)}: this version of wayside computes other inputs than the model takes; they differ "
                f"in {', '.join(sorted(inputs))}. Learn it again."
            )


def _check_gate(
    model: GaussianModel, names: Sequence[str] | None, spaces: Mapping[str, int]
) -> None:
    """Refuse a gate with no class or threshold, an unknown name or space, or other dimensions than its space has."""
    found = [one.name for one in model.classes]
    unknown = [name for name in found if names is not None and name not in names]
    dimensions = spaces.get(model.space)
    means = {one.mean.shape for one in (*model.classes, *model.background)}
    for fault, words in (
        (dimensions is None, f"there is no space {model.space!r} among {', '.join(spaces)}"),
        (not found, "it has no class"),
        (unknown, f"there is no class {unknown} among {', '.join(names or ())}"),
        (means - {(dimensions,)}, f"a class has {dimensions} numbers in space {model.space!r}"),
        (not model.threshold_rule, "it has no threshold, as those of earlier versions of wayside"),
    ):
        if fault:
            raise InputError(f"model of {', '.join(found)}: {words}. Learn it again.")


def _at_alpha(models: Models, settings: Settings) -> Models:
    """The models with gates of the run at false-alarm rates.

    Raises UsageError for what is no rate or gate, InputError where a gate has no such operating point.
    """
    gates = ["color_classes", "shape_classes", "trajectory_density"]
    if settings.report.on and settings.locate.gate:
        gates.append("location_classes")
    if not settings.report.on and models.external is None:
        gates.append("landmark_classifier")
        gates += [] if models.back_scores is None else ["back_landmark_classifier"]
    known = {_NAMES[gate]: gate for gate in gates if getattr(models, gate) is not None}
    lacking: list[str] = []
    moved: dict[str, Any] = {}
    for name, rate in _rates(settings.models.alpha, list(known)).items():
        try:
            moved[known[name]] = at_alpha(getattr(models, known[name]), rate)
        except ValueError as error:
            lacking.append(f"{name}: {error}")
    if lacking:
        raise InputError(
            "models.alpha: not every gate of the run has a threshold for this false-alarm rate: "
            f"{'; '.join(lacking)}. Take a larger rate, learn these models again, or leave the rate out."
        )
    return replace(models, **moved)


def _rates(text: str, gates: Sequence[str]) -> dict[str, float]:
    """False-alarm rate of each gate that a text names, as `0.1` (all of them) or `color=0.1,location=0.05`."""
    rates: dict[str, float] = {}
    for part in text.split(","):
        name, _, rate = part.rpartition("=")
        named = [name.strip()] if name else gates
        try:
            rates |= dict.fromkeys(named, float(rate))
        except ValueError:
            named = []
        if not named or not {*named} <= {*gates} or not 0 < rates[named[0]] <= 1:
            exist = ", ".join(gates) or "none, because a detector of another kind decides"
            raise UsageError(
                f"--alpha (models.alpha): {part!r} is not a rate between 0 and 1, nor a gate with one. Write 0.1 or "
                f"color=0.1,location=0.05; the gates of this run are: {exist}."
            )
    return rates
