"""The models of a run: those that ship with wayside, or a folder of the user's own files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TypeVar

from wayside.schemas.errors import InputError
from wayside.schemas.models import (
    GaussianModel,
    LinearModel,
    Model,
    NetworkModel,
    TreeModel,
    digest,
    model_from_json,
    model_to_json,
)
from wayside.schemas.settings import Settings

REPORT_PLACE = "report"
"""The class of the location model that is the report's single mean; the others are the mixture."""

Kind = TypeVar("Kind", GaussianModel, TreeModel, NetworkModel, LinearModel)


@dataclass(frozen=True, slots=True)
class Models:
    """Everything learned that a run uses.

    `place` judges a place over all its views; `face_color` and `face_shape` name the face in a view, `face_box` says
    where it ends; `back` and `back_place` judge what is seen of panels from behind; `ranking` says which regions are
    likely faces at all; where they exist. `outline` chooses the outer outline of a panel.
    """

    color: GaussianModel
    shape: GaussianModel
    judge: TreeModel
    location: GaussianModel
    outline: LinearModel
    place: TreeModel | None = None
    face_color: NetworkModel | None = None
    face_shape: NetworkModel | None = None
    face_box: NetworkModel | None = None
    back: TreeModel | None = None
    back_place: TreeModel | None = None
    ranking: TreeModel | None = None

    def digests(self) -> dict[str, str]:
        """SHA-256 of each model's text, by its name."""
        named: dict[str, Model | None] = {
            "color": self.color,
            "shape": self.shape,
            "judge": self.judge,
            "location": self.location,
            "outline": self.outline,
            "place": self.place,
            "face_color": self.face_color,
            "face_shape": self.face_shape,
            "face_box": self.face_box,
            "back": self.back,
            "back_place": self.back_place,
            "ranking": self.ranking,
        }
        return {
            name: digest(model_to_json(model)) for name, model in named.items() if model is not None
        }


def load_models(settings: Settings) -> Models:
    """The models that the settings ask for: the report's colours, shapes and single mean, or the default ones.

    Each file is taken from the folder `models.folder` where it is there, else from those that ship.

    Raises
    ------
    InputError
        If the folder or a file of it cannot be used.
    """
    folder = _own_folder(settings.models.folder)
    by_report = settings.candidates.judge == "report"
    color = _gaussian(folder, "color_rgb.json" if by_report else "color.json")
    shape = _gaussian(folder, "shape.json" if by_report else "shape_oriented.json")
    location = _gaussian(folder, "location.json")
    wanted = tuple(c for c in location.classes if (c.name == REPORT_PLACE) == by_report)

    def optional(load: Callable[[Path | None, str], Kind], name: str) -> Kind | None:
        return load(folder, name) if _exists(folder, name) and not by_report else None

    return Models(
        color,
        shape,
        _trees(folder, "judge.json"),
        replace(location, classes=wanted),
        _linear(folder, "outline.json"),
        _trees(folder, "place.json") if _exists(folder, "place.json") else None,
        optional(_network, "face_color.json"),
        optional(_network, "face_shape.json"),
        optional(_network, "face_box.json"),
        optional(_trees, "back.json"),
        optional(_trees, "back_place.json"),
        optional(_trees, "ranking.json"),
    )


def shipped_models() -> Traversable:
    """The folder of the model files that ship with wayside."""
    return files("wayside.pipeline") / "models"


def _own_folder(name: str) -> Path | None:
    if not name:
        return None
    folder = Path(name)
    if not folder.is_dir():
        raise InputError(
            f"models.folder: wanted a folder of model files, found none at {name}; "
            "correct the path or leave the setting out for the models that ship"
        )
    return folder


def _exists(folder: Path | None, name: str) -> bool:
    return _file(folder, name).is_file()


def _file(folder: Path | None, name: str) -> Traversable:
    own = None if folder is None else folder / name
    return own if own is not None and own.is_file() else shipped_models() / name


def _read(folder: Path | None, name: str) -> Model:
    file = _file(folder, name)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{file}: wanted a readable model file, found {type(error).__name__}: {error}; "
            "write one with the learning script or install wayside again"
        ) from error
    return model_from_json(text, str(file))


def _of_kind(kind: type[Kind]) -> Callable[[Path | None, str], Kind]:
    def load(folder: Path | None, name: str) -> Kind:
        model = _read(folder, name)
        if not isinstance(model, kind):
            raise InputError(
                f"{_file(folder, name)}: wanted a model of kind {kind.kind!r}, found {model.kind!r}; "
                "put the file of the right kind there"
            )
        return model

    return load


_gaussian = _of_kind(GaussianModel)
_trees = _of_kind(TreeModel)
_network = _of_kind(NetworkModel)
_linear = _of_kind(LinearModel)
