"""The models of a run: those that ship with wayside, or a folder of the user's own files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TypeVar

from scipy.special import expit, logit

from wayside.pipeline.files.input_files import read_input
from wayside.pipeline.labels.box_file import load_boxes
from wayside.pipeline.models.detector_file import load_detector
from wayside.pipeline.models.model_gates import retraded
from wayside.pipeline.models.model_json import digest, model_from_json, model_to_json
from wayside.pipeline.models.provenance import onnx_metadata
from wayside.schemas.detectors import BoxFile, DetectorFile
from wayside.schemas.errors import InputError
from wayside.schemas.landmarks import EVIDENCE_TERMS
from wayside.schemas.models import (
    EvidenceModel,
    GaussianModel,
    LinearModel,
    MixtureModel,
    Model,
    OnnxFile,
    ScoreModel,
)
from wayside.schemas.settings import Settings
from wayside.stages.detection import BoxNetwork, DetectionNetwork
from wayside.stages.mapping import FEATURES as LANDMARK_FEATURES
from wayside.stages.panel import OUTLINE_FEATURES
from wayside.stages.sign_codes import CLASSES, FaceClassifier

DIGESTS = "SHA256SUMS"
REPORT_CLASS = "report"
"""Class of a location file that is of preset `report`; the others of such a file are of preset `default`."""

BOX_NETWORK, FACE_NETWORK = "box.onnx", "face_code.onnx"

LOCATION, REPORT_LOCATION = "location.json", "location_report.json"

TRAJECTORY_FILES = {"image": "trajectory.json", "compensated": "trajectory_compensated.json"}
"""Density of the trajectories of signs, by its form."""

OWN_COLORS = "color.json"
"""Colours that `wayside fit` writes: their space need not be RGB."""

Kind = TypeVar(
    "Kind",
    GaussianModel,
    MixtureModel,
    ScoreModel,
    LinearModel,
    EvidenceModel,
)


@dataclass(frozen=True, slots=True)
class Models:
    """Everything learned that a run uses.

    `color_classes`, `shape_classes`: the report's Gaussian classes of regions. `trajectory_density`: of the motion of
    signs in the image; these are None where a preset does not ask for them. `location_classes`: where signs stand.
    `outline_weights`: which of several concentric outlines of a panel is the outer one. `detection_network`: finds the
    boxes that are classified. `box_network`: classifies boxes, moves them onto panels, names their colour and shape.
    `front_scores`, `back_scores`: which of its scores are accepted, of panels from the front and from behind.
    `landmark_classifier`, `back_landmark_classifier`: of a landmark by all its observations. `face_network`: what sign
    a face shows. None where there is no such file, or the report's chain needs none. `external`: another detector, or
    its boxes, that takes the place of wayside's own; or None.
    """

    location_classes: GaussianModel
    outline_weights: LinearModel
    color_classes: GaussianModel | None = None
    shape_classes: GaussianModel | None = None
    landmark_classifier: EvidenceModel | None = None
    back_landmark_classifier: EvidenceModel | None = None
    front_scores: ScoreModel | None = None
    back_scores: ScoreModel | None = None
    box_network: OnnxFile | None = None
    detection_network: OnnxFile | None = None
    external: DetectorFile | BoxFile | None = None
    trajectory_density: MixtureModel | None = None
    face_network: OnnxFile | None = None

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
        digests = {
            name: model.text_digest or digest(model_to_json(model))
            for name, model in self._named().items()
        }
        digests |= {name: network.sha256 for name, network in self._networks().items()}
        if isinstance(self.external, DetectorFile):
            digests["detector"] = self.external.onnx.sha256
        elif self.external is not None:
            digests["detections"] = self.external.sha256
        return digests

    def provenances(self) -> dict[str, str]:
        """What each model says it was learned from, by the name of its file."""
        provenances = {name: model.provenance for name, model in self._named().items()}
        for name, network in self._networks().items():
            said = onnx_metadata(Path(network.path).read_bytes())
            provenances[name] = "; ".join(text for key, text in said.items() if key != CLASSES)
        return provenances

    def _networks(self) -> dict[str, OnnxFile]:
        named = {
            "network": self.detection_network,
            "box": self.box_network,
            "face_code": self.face_network,
        }
        return {name: network for name, network in named.items() if network is not None}

    def _named(self) -> dict[str, Model]:
        named: dict[str, Model | None] = {
            "color": self.color_classes,
            "shape": self.shape_classes,
            "location": self.location_classes,
            "outline": self.outline_weights,
            "place": self.landmark_classifier,
            "front": self.front_scores,
            "back": self.back_scores,
            "back_place": self.back_landmark_classifier,
            "trajectory": self.trajectory_density,
        }
        return {name: model for name, model in named.items() if model is not None}


@dataclass(slots=True)
class ModelFolder:
    """Where model files are searched: in a folder of the user's own (or None), then in those that ship.

    wanted: names that were looked for; own: those that the folder holds.
    """

    path: Path | None = None
    wanted: set[str] = field(default_factory=set)
    own: set[str] = field(default_factory=set)

    @classmethod
    def of(cls, name: str) -> ModelFolder:
        """The folder of that name, none where it is empty; raises InputError where no folder is there."""
        path = Path(name) if name else None
        if path is not None and not path.is_dir():
            raise InputError(
                f"models.folder: there is no folder at {name}. Correct the path, or leave the setting out to use the "
                "models that ship."
            )
        return cls(path)

    def file(self, name: str) -> Traversable:
        """The file of a model, whether it is there or not."""
        if self.holds_own(name):
            assert self.path is not None
            return self.path / name
        return shipped_models() / name

    def holds(self, name: str) -> bool:
        """Whether there is a model of that name."""
        return self.file(name).is_file()

    def holds_own(self, name: str) -> bool:
        """Whether the user's folder has a model of that name."""
        self.wanted.add(name)
        if self.path is None or not (self.path / name).is_file():
            return False
        self.own.add(name)
        return True

    def require_used(self) -> None:
        """Refuse a folder none of whose files was looked for (InputError): the models that ship would all stand in."""
        if self.path is not None and not self.own:
            raise InputError(
                f"models.folder: {self.path} holds no model file of this preset ({', '.join(sorted(self.wanted))}). "
                "Correct the path, or leave the setting out to use the models that ship."
            )


def load_models(settings: Settings) -> Models:
    """The models that the settings ask for: the report's colours, shapes and single mean, or the networks of `default`.

    Each file is taken from the folder `models.folder` where it is there, else from those that ship.

    Raises
    ------
    InputError
        If the folder or a file of it cannot be used.
    """
    folder = ModelFolder.of(settings.models.folder)
    by_report = settings.report.on
    external = _external(settings)
    own_networks = not by_report and external is None

    def optional(load: Callable[[ModelFolder, str], Kind], name: str) -> Kind | None:
        return load(folder, name) if folder.holds(name) and not by_report else None

    models = Models(
        _location(folder, settings.models.location, by_report=by_report),
        _linear(folder, "outline.json"),
        _colors(folder) if by_report else None,
        _gaussian(folder, "shape.json") if settings.report.shape else None,
        optional(_evidence, "place.json"),
        optional(_evidence, "back_place.json"),
        None if by_report else _score(folder, "front.json"),
        optional(_score, "back.json"),
        None if by_report else _onnx(folder, BOX_NETWORK, "models.folder", BoxNetwork),
        _onnx(folder, settings.models.network, "models.network", DetectionNetwork)
        if own_networks and settings.models.network
        else None,
        external,
        None
        if settings.report.trajectory == "off"
        else _mixture(folder, TRAJECTORY_FILES[settings.report.trajectory]),
        None if by_report else _onnx(folder, FACE_NETWORK, "models.folder", FaceClassifier),
    )
    _check_inputs(models, folder)
    folder.require_used()
    return retraded(models, settings) if settings.models.alpha else models


def _check_inputs(models: Models, folder: ModelFolder) -> None:
    """Refuse models of other inputs than those that the stages compute, before the first image."""
    if models.outline_weights.features != OUTLINE_FEATURES:
        raise InputError(
            f"{folder.file('outline.json')}: the file has weights of {', '.join(models.outline_weights.features)}, "
            f"but this version of wayside uses {', '.join(OUTLINE_FEATURES)}. Learn it again."
        )
    for name, evidence in (
        ("place.json", models.landmark_classifier),
        ("back_place.json", models.back_landmark_classifier),
    ):
        if evidence is None:
            continue
        names = {*evidence.features} - {*LANDMARK_FEATURES} | {*evidence.terms} - {*EVIDENCE_TERMS}
        if names or not evidence.features:
            raise InputError(
                f"{folder.file(name)}: this version of wayside does not know the feature or term of evidence "
                f"{min(names, default='none')!r}. Learn it again."
            )


def _colors(folder: ModelFolder) -> GaussianModel:
    """Colours of the user's own in any space (`color.json`), else those of the report, in RGB."""
    return _gaussian(folder, OWN_COLORS if folder.holds_own(OWN_COLORS) else "color_rgb.json")


def _location(folder: ModelFolder, name: str, *, by_report: bool) -> GaussianModel:
    """The location model that is named, or that of the preset.

    A folder of the user's own may hold the location of preset `report` as the class `REPORT_CLASS` of its
    `location.json`.
    """
    if name:
        shipped = f"{Path(name).stem}.json"
        if (shipped_models() / shipped).is_file() and not Path(name).is_file():
            return _gaussian(ModelFolder(), shipped)
        if not Path(name).is_file():
            raise InputError(
                f"models.location: there is no model file at {name}. Correct the path, name report-kansas, or leave "
                "the setting out."
            )
        return _gaussian(ModelFolder(Path(name).parent), Path(name).name)
    names = (LOCATION, REPORT_LOCATION) if by_report else (LOCATION,)
    own = [name for name in names if folder.holds_own(name)]
    if by_report and own != [LOCATION]:
        return _gaussian(folder, REPORT_LOCATION)
    location = _gaussian(folder, LOCATION)
    classes = tuple(c for c in location.classes if (c.name == REPORT_CLASS) == by_report)
    if by_report and not classes:
        return _gaussian(ModelFolder(), REPORT_LOCATION)
    return replace(location, classes=classes)


def _external(settings: Settings) -> DetectorFile | BoxFile | None:
    if settings.models.detector:
        return load_detector(settings.models)
    return load_boxes(settings) if settings.models.detections else None


def shipped_models() -> Traversable:
    """The folder of the model files that ship with wayside."""
    return files("wayside.pipeline") / "models"


def _onnx(folder: ModelFolder, name: str, setting: str, kind: Callable[[str], object]) -> OnnxFile:
    """A network of a folder of models, of those that ship, or of a file of its own, that `kind` can run."""
    listed = Path(str(folder.file(name)))
    path = listed if listed.is_file() else Path(name)
    try:
        content = read_input(path)
        _verify(path, content)
        held = OnnxFile(str(path), sha256(content).hexdigest())
        kind(held.path)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{setting}: the ONNX file of this network at {name} cannot be used: {type(error).__name__}: {error}. "
            "Correct the path, or leave the setting out."
        ) from error
    return held


def _read(folder: ModelFolder, name: str) -> Model:
    file = folder.file(name)
    try:
        content = file.read_bytes()
        text = content.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{file}: the model file cannot be read: {type(error).__name__}: {error}. Write one with the learning "
            "script, or install wayside again."
        ) from error
    _verify(file, content)
    return model_from_json(text, str(file))


def _verify(file: Traversable, content: bytes) -> None:
    """Compare a file that ships with its digest in `SHA256SUMS`; files of the user's own have none."""
    if str(file) != str(shipped_models() / file.name):
        return
    if sha256(content).hexdigest() != shipped_digests().get(file.name):
        raise InputError(
            f"{file}: the file differs from the model that ships with wayside. Install wayside again, or put a model "
            "of your own into a folder and name it in models.folder."
        )


@cache
def shipped_digests() -> dict[str, str]:
    """SHA-256 of each model file that ships, by its name."""
    try:
        lines = (shipped_models() / DIGESTS).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{shipped_models() / DIGESTS}: the digests of the models cannot be read: {error}. Install wayside again."
        ) from error
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def _of_kind(kind: type[Kind]) -> Callable[[ModelFolder, str], Kind]:
    def load(folder: ModelFolder, name: str) -> Kind:
        model = _read(folder, name)
        if not isinstance(model, kind):
            raise InputError(
                f"{folder.file(name)}: this is a model of kind {model.kind!r}, but {kind.kind!r} belongs here. Put "
                "the right file there."
            )
        return model

    return load


_gaussian = _of_kind(GaussianModel)
_mixture = _of_kind(MixtureModel)
_score = _of_kind(ScoreModel)
_linear = _of_kind(LinearModel)
_evidence = _of_kind(EvidenceModel)
