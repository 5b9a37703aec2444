"""Labels: what a person, or the truth of a rendered drive, says about boxes in images. The file is one Parquet table.

Boxes `(x0, y0, x1, y1)`, half open, and polygons are in pixels of the image as recorded, from its upper left corner.
Boxes of the tables of a result are the same. The middle of the first pixel is at (0.5, 0.5) in these coordinates.
"""

from dataclasses import dataclass, field

import pyarrow as pa

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.tables import Column, Table, alike

SIGN, BACK, NOT_A_SIGN, UNSURE = "sign", "back", "not_sign", "unsure"
COMPLETE = "complete"
LABEL_KINDS = {
    SIGN: "the face of a road sign",
    BACK: "a road sign seen from behind",
    NOT_A_SIGN: "something else: a sample of what no sign is",
    UNSURE: "examined, not decided: neither right nor wrong",
    COMPLETE: "no box: every sign of this image is labelled, so the rest of it shows none",
}

Box = tuple[float, float, float, float]
Polygon = tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """Which image a label is of: at least one of frame, log time and file name."""

    log: str | None = None
    """Stem of the log's file name."""
    frame: int | None = None
    """Index in the log, from 0."""
    log_time_ns: int | None = None
    """When it was logged."""
    image_name: str | None = None
    """Its file, or its path below the folder of images."""
    size: tuple[int, int] | None = None
    """Width and height, pixels."""

    def __post_init__(self) -> None:
        """Refuse an image that no field names, and numbers beyond the range of the file."""
        known = (
            (self.frame or 0, 31),
            (self.log_time_ns or 0, 63),
            *((s, 20) for s in self.size or ()),
        )
        if any(abs(number) >= 1 << bits for number, bits in known) or min(self.size or (1,)) < 1:
            raise ValueError(f"no image has these numbers: {[number for number, _ in known]}")
        if self.frame is None and self.log_time_ns is None and not self.image_name:
            raise ValueError("an image of a label is named by its frame, its log time or its file")


@dataclass(frozen=True, slots=True)
class Label:
    """One thing in one image."""

    image: LabelledImage
    """Where it is."""
    kind: str
    """`SIGN`, `BACK`, `NOT_A_SIGN` or `UNSURE`."""
    box: Box
    """x0, y0, x1, y1 around the whole face with its border, pixels."""
    color: str | None = None
    """One of `COLORS`. None: unknown, or none of them."""
    shape: str | None = None
    """One of `SHAPES`. None: unknown, or none of them."""
    polygon: Polygon = ()
    """Outline of the face, pixels. Empty: only the box is known."""
    panel: str | None = None
    """Name of the physical thing, the same in all images that show it. None: unknown."""
    visible: float | None = None
    """Fraction of the face that nothing hides, 0 to 1. None: unknown."""
    wanted: bool = True
    """Whether it counts for recall. What does not is neither right nor wrong."""
    source: str = ""
    """Who or what says so: a reviewer, a file."""
    note: str = ""
    """Words of the reviewer, or what it is."""

    def __post_init__(self) -> None:
        """Refuse an invalid label: an unknown kind or class, a box without area."""
        if self.kind not in LABEL_KINDS or self.kind == COMPLETE:
            known = ", ".join(kind for kind in LABEL_KINDS if kind != COMPLETE)
            raise ValueError(f"kind {self.kind!r} is not one of {known}")
        if self.color is not None and self.color not in COLORS:
            raise ValueError(f"colour {self.color!r} is not one of {', '.join(COLORS)}")
        if self.shape is not None and self.shape not in SHAPES:
            raise ValueError(f"shape {self.shape!r} is not one of {', '.join(SHAPES)}")
        x0, y0, x1, y1 = self.box
        if not (-1e6 < x0 < x1 < 1e6 and -1e6 < y0 < y1 < 1e6):
            raise ValueError(f"box {self.box} has no area, or is not finite")

    @property
    def height_px(self) -> float:
        """Height of the box."""
        return self.box[3] - self.box[1]


@dataclass(frozen=True, slots=True)
class Labels:
    """Labels, and the images in which every sign is labelled: only there, what has no label is no sign."""

    labels: tuple[Label, ...] = ()
    """All of them."""
    complete: tuple[LabelledImage, ...] = ()
    """Images in which every sign is labelled."""
    left_out: dict[str, int] = field(default_factory=dict)
    """Number of entries that were read and are not among the labels, by reason."""
    first: dict[str, str] = field(default_factory=dict)
    """Where the first entry of a reason stands and what is wrong with it, where known."""

    @property
    def reasons(self) -> str:
        """What is left out, in words."""
        return ", ".join(
            f"{count} {reason}" + (f" ({self.first[reason]})" if reason in self.first else "")
            for reason, count in self.left_out.items()
        )


_TEXT, _FLAG, _WHOLE, _LONG, _REAL = pa.string(), pa.bool_(), pa.int32(), pa.int64(), pa.float64()
_CHOICE = pa.dictionary(pa.int8(), pa.string())
_POINTS = pa.list_(pa.field("element", pa.list_(pa.field("element", pa.float64()), 2)))

LABELS = Table(
    "labels",
    "One row per thing in one image, or per image whose signs are all labelled (`kind` is `complete`). At least one of "
    "`frame`, `log_time_ns` and `image_name` is not null.",
    (
        Column("log", _TEXT, "", "stem of the log's file name; null: any log, or images without one"),
        Column("frame", _WHOLE, "", "index of the frame in the log, from 0"),
        Column("log_time_ns", _LONG, "ns", "time at which it was logged"),
        Column("image_name", _TEXT, "", "file name of the image, or its path below the folder of images"),
        *alike("image_width image_height", _WHOLE, "px", "size of the image that the box is of"),
        Column("kind", _CHOICE, "", "what it is", False, tuple(LABEL_KINDS)),
        Column("x_min", _REAL, "px", "box around the whole face with its border, half open; null: `complete`"),
        *alike("y_min x_max y_max", _REAL, "px", "the same"),
        Column("polygon", _POINTS, "px", "outline of the face; null: only the box is known"),
        Column("color", _CHOICE, "", "colour class of the face; null: not known, or none of them", values=COLORS),
        Column("shape", _CHOICE, "", "shape class of the face; null: not known, or none of them", values=SHAPES),
        Column("panel", _TEXT, "", "name of the physical thing, the same in all images of it"),
        Column("visible", _REAL, "", "fraction of the face that nothing hides, 0 to 1"),
        Column("wanted", _FLAG, "", "whether it counts for recall", False),
        Column("source", _TEXT, "", "who or what says so", False),
        Column("note", _TEXT, "", "words of the reviewer, or what it is", False),
    ),
)  # fmt: skip
