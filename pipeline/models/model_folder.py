"""Model files: where they are searched, how they are read, and the digests of those that ship."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Self, TypeVar

from wayside.pipeline.files.input_files import read_input
from wayside.pipeline.models.model_json import model_from_json
from wayside.schemas.errors import InputError
from wayside.schemas.models import Model, OnnxFile

_ADVICE = "Correct the path, or leave the setting out"

Kind = TypeVar("Kind", bound=Model)


@dataclass(slots=True)
class ModelFolder:
    """Where model files are searched: in a folder of the user's own (or None), then in those that ship.

    Its methods raise InputError where a file cannot be used.
    """

    path: Path | None = None
    wanted: set[str] = field(default_factory=set)
    """Names that were looked for."""
    used: bool = False
    """Whether the user's folder held one of them."""

    @classmethod
    def of(cls, name: str) -> Self:
        """The folder of that name, None if the name is empty; raises InputError where there is no such folder."""
        if name and not Path(name).is_dir():
            raise InputError(
                f"models.folder: there is no folder at {name}. {_ADVICE} to use the models that ship."
            )
        return cls(Path(name) if name else None)

    def own_file(self, name: str) -> Path | None:
        """A file of the user's folder, if it exists."""
        self.wanted.add(name)
        if self.path is None or not (self.path / name).is_file():
            return None
        self.used = True
        return self.path / name

    def file(self, name: str) -> Traversable:
        """The file of a model, whether it exists or not."""
        return self.own_file(name) or shipped_models() / name

    def holds(self, name: str) -> bool:
        """Whether there is a model of that name."""
        return self.file(name).is_file()

    def find(self, name: str, kind: type[Kind]) -> Kind | None:
        """The same as `read`; None where there is no such file."""
        return self.read(name, kind) if self.holds(name) else None

    def read(self, name: str, kind: type[Kind]) -> Kind:
        """A model of a kind."""
        file = self.file(name)
        try:
            content = file.read_bytes()
            text = content.decode("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"{file}: the model file cannot be read: {type(error).__name__}: {error}. Write one with the learning "
                "script, or install wayside again."
            ) from error
        _verify(file, content)
        model = model_from_json(text, str(file))
        if not isinstance(model, kind):
            raise InputError(
                f"{file}: this is a model of kind {model.kind!r}, but {kind.kind!r} belongs here. Put the right file "
                "there."
            )
        return model

    def network(
        self, name: str, runs: Callable[[str], object], setting: str = "models.folder"
    ) -> OnnxFile:
        """A network of the folder, of those that ship, or of a file of its own, that `runs` can run."""
        listed = Path(str(self.file(name)))
        path = listed if listed.is_file() else Path(name)
        try:
            content = read_input(path)
            _verify(path, content)
            runs(str(path))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{setting}: the ONNX file of this network at {name} cannot be used: {type(error).__name__}: {error}. "
                f"{_ADVICE}."
            ) from error
        return OnnxFile(str(path), sha256(content).hexdigest())

    def require_used(self) -> None:
        """Refuse a folder without a file that is known (InputError): only shipped models would be used."""
        if self.path is not None and not self.used:
            raise InputError(
                f"models.folder: {self.path} holds no model file of this preset ({', '.join(sorted(self.wanted))}). "
                f"{_ADVICE} to use the models that ship."
            )


def shipped_models() -> Traversable:
    """The folder of the model files that ship with wayside."""
    return files("wayside.pipeline") / "models"


@cache
def shipped_digests() -> dict[str, str]:
    """SHA-256 of each model file that ships, by its name."""
    listed = shipped_models() / "SHA256SUMS"
    try:
        lines = listed.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{listed}: the digests of the models cannot be read: {error}. Install wayside again."
        ) from error
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def _verify(file: Traversable, content: bytes) -> None:
    """Compare a file that ships with its digest in `SHA256SUMS`; files of the user's own have none."""
    ships = str(file) == str(shipped_models() / file.name)
    if ships and sha256(content).hexdigest() != shipped_digests().get(file.name):
        raise InputError(
            f"{file}: the file differs from the model that ships with wayside. Install wayside again, or put a model "
            "of your own into a folder and name it in models.folder."
        )
