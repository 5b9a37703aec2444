"""Recall on rendered drives by height and colour of the face and by stage; reliability of the confidence.

    OMP_NUM_THREADS=1 .venv/bin/python benchmarks/seeing.py [--only NAME]

Runs preset `default` as shipped on each drive that `make accept` measures, with all regions listed; then again, and on
drives of the same specifications from other seeds, with a landmark classifier with a very low threshold. Writes
benchmarks/seeing.md and docs/seeing.png, and prints every face of some height that is no part of a sign; with --only it
prints the page and writes nothing.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
from accept import DRIVES, RENDERED, BenchmarkDrive, render
from confidence import Result, Row, confidence_lines, evaluated_at, reliability
from reached import (
    CANDIDATE,
    CLASSIFIED,
    PASSED,
    SIGN,
    STOPPED,
    bin_names,
    bin_of,
    reached,
    shares,
    table,
)
from seeing_plot import draw

from wayside.pipeline.evaluation import SMALLEST_HEIGHT_PX, SMALLEST_VISIBLE, is_eligible
from wayside.pipeline.lengths import parse_length
from wayside.pipeline.model_files import load_models
from wayside.pipeline.run import run_log
from wayside.pipeline.settings_file import load_settings
from wayside.schemas.detections import COLORS
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

ROOT = Path(__file__).resolve().parents[1]
PAGE, IMAGE = ROOT / "benchmarks" / "seeing.md", ROOT / "docs" / "seeing.png"
HEIGHTS = (10, 12, 15, 20, 25, 35, 50, 100)
CLEAR_PX = 15.0
"""Height from which a face should have a candidate."""
STAGES = (CANDIDATE, CLASSIFIED, PASSED, SIGN)
HEAD = (
    "faces",
    "candidate",
    "classified",
    "passed classifier",
    "part of a sign",
    "of wanted",
)
HARDLY_ANY = -12.0
"""Log odds below which the landmark classifier refuses, where rows of low confidence are wanted."""
OTHER_SEEDS = {"straight": 9778, "curve": 9775, "town": 9774, "report": 9776}
"""Specifications that are rendered once more, and their other seed: more rows to hold a confidence to."""


@dataclass(frozen=True, slots=True)
class FaceOutcome:
    """The front of a sign in one image: where it is, what it shows, and how far its candidates went.

    wanted: whether it is seen in images enough to be reported.
    """

    drive: str
    sign: int
    kind: str
    color: str
    frame: int
    box: tuple[float, ...]
    wanted: bool
    level: int

    @property
    def height_px(self) -> float:
        """Height in the image."""
        return self.box[3] - self.box[1]


@dataclass(frozen=True, slots=True)
class DriveOutcome:
    """One drive as shipped: faces, images, candidates and those that are classified, cost of proposing.

    decodes: processor time of proposing in that of decoding a JPEG of the drive; None where its images are raw.
    """

    name: str
    faces: tuple[FaceOutcome, ...]
    images: int
    candidates: int
    classified: int
    decodes: float | None


def main() -> int:
    """Run, count, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", choices=RENDERED, help="this drive only")
    chosen = parser.parse_args().only
    names = [name for name in RENDERED if not chosen or name in chosen]
    cv2.setNumThreads(1)
    render(names, 2)
    known = [drive_of(name, DRIVES, RENDERED[name]) for name in names]
    other = list(fresh_drives([name for name in names if name in OTHER_SEEDS]))
    with tempfile.TemporaryDirectory() as scratch:
        fresh = [result_of(drive, Path(scratch), HARDLY_ANY) for drive in other]
        lenient = [result_of(drive, Path(scratch), HARDLY_ANY) for drive in known]
        shipped = [result_of(drive, Path(scratch), None) for drive in known]
        seen = [seen_on(drive, Path(scratch) / drive.name) for drive in known]
    text = page(seen, confidence_lines(lenient, fresh, evaluated_at(shipped, 0.5)))
    if chosen:
        print(text)
        return 0
    PAGE.write_text(text)
    for drive in seen:
        print("\n".join(lost_lines(drive.faces)))
    faces = [face for drive in seen for face in drive.faces]
    shown = draw(
        bin_names(HEIGHTS, "px"),
        [
            [f.level for f in faces if bin_of(f.height_px, HEIGHTS) == k]
            for k in range(len(HEIGHTS))
        ],
        [(one.mean, one.right, one.rows) for one in reliability([*lenient, *fresh]) if one.rows],
    )
    cv2.imwrite(str(IMAGE), cv2.cvtColor(shown, cv2.COLOR_RGB2BGR))
    return 0


def drive_of(name: str, folder: Path, spacing: str) -> BenchmarkDrive:
    """A rendered drive of a folder."""
    return BenchmarkDrive(name, folder / f"{name}.mcap", folder / f"{name}.truth.json", spacing)


def fresh_drives(names: Sequence[str]) -> Iterator[BenchmarkDrive]:
    """Drives of the specifications `names` from other seeds, rendered where they are not there yet."""
    folder = DRIVES.parent / "fresh"
    (folder / "specs").mkdir(parents=True, exist_ok=True)
    for name in names:
        text = (ROOT / "recordings" / "drives" / "specs" / f"{name}.toml").read_text()
        spec = folder / "specs" / f"fresh_{name}.toml"
        spec.write_text(reseeded(text, name))
        command = [sys.executable, "-m", "recordings.drives", str(spec), "-o", str(folder)]
        subprocess.run([*command, "--missing", "--jobs", "2"], cwd=ROOT, check=True)
        yield drive_of(f"fresh_{name}", folder, RENDERED[name])


def reseeded(text: str, name: str) -> str:
    """The text of a specification with another name and seed."""
    text = text.replace(f'name = "{name}"', f'name = "fresh_{name}"', 1)
    return re.sub(r"^seed = \d+$", f"seed = {OTHER_SEEDS[name]}", text, count=1, flags=re.M)


def result_of(drive: BenchmarkDrive, folder: Path, threshold: float | None) -> Result:
    """Rows of `signs.parquet` but backs, all regions listed, and the truth.

    `threshold` replaces that of the landmark classifier.
    """
    options = {"read.spacing_m": parse_length(drive.spacing)} if drive.spacing else {}
    settings, _ = load_settings("default", None, [], options | {"run.workers": 1})
    models = load_models(settings)
    if threshold is not None and models.landmark_classifier is not None:
        landmark = replace(models.landmark_classifier, threshold=threshold)
        models = replace(models, landmark_classifier=landmark)
    run_log(drive.log, folder / drive.name, settings, models, arguments=[], every_region=True)
    print(drive.name, file=sys.stderr, flush=True)
    truth: Row = json.loads(drive.truth.read_text())
    rows = pq.read_table(folder / drive.name / SIGNS.file).to_pylist()
    return [row for row in rows if row["status"] != "back"], truth


def seen_on(drive: BenchmarkDrive, out: Path) -> DriveOutcome:
    """What the tables of a run say about the faces of its drive."""
    truth = json.loads(drive.truth.read_text())
    listed = pq.read_table(out / OBSERVATIONS.file, columns=["frame", "box", "verdict"])
    frames = pq.read_table(out / FRAMES.file, columns=["frame", "status"]).to_pylist()
    used = [row["frame"] for row in frames if row["status"] == "used"]
    frame = np.asarray(listed["frame"])
    boxes = np.array(listed["box"].to_pylist(), np.float64).reshape(-1, 4)
    verdicts = np.array(listed["verdict"].to_pylist())
    rows = {index: np.flatnonzero(frame == index) for index in used}
    faces = [
        FaceOutcome(
            drive.name,
            sign["id"],
            sign["kind"],
            sign["color"],
            view["frame"],
            tuple(view["box"]),
            is_eligible(sign),
            reached(view["box"], boxes[rows[view["frame"]]], verdicts[rows[view["frame"]]]),
        )
        for sign, view in fronts(truth)
        if view["frame"] in rows
    ]
    cost = json.loads((out / "run.json").read_text())["times"]["cpu_s_by_stage"]
    return DriveOutcome(
        drive.name,
        tuple(faces),
        len(used),
        len(verdicts),
        int((~np.isin(verdicts, ("size",))).sum()),
        None if drive.name == "raw" else cost["propose"] / cost["decode"],
    )


def fronts(truth: Row) -> Iterator[tuple[Row, Row]]:
    """Signs with their views that should be seen: the front, tall and visible enough."""
    for sign in truth["signs"]:
        for view in sign["frames"]:
            tall = view["box"][3] - view["box"][1] >= SMALLEST_HEIGHT_PX
            visible = (view["visible_fraction"] or 0.0) >= SMALLEST_VISIBLE
            if sign["faces_travel"] and view["side"] == "front" and tall and visible:
                yield sign, view


def page(seen: Sequence[DriveOutcome], confidence: Sequence[str]) -> str:
    """The page, with the part on confidence at its end."""
    faces = [face for drive in seen for face in drive.faces]
    clear = [face for face in faces if face.height_px >= CLEAR_PX]
    heights = bin_names(HEIGHTS, "px")
    lines = [
        "# Recall by face",
        "",
        "Made by `python benchmarks/seeing.py`, preset `default`, on the rendered drives that `make accept` measures;",
        "no model was learned from them. A face is the front of a sign in one image, at least half visible.",
        "",
        "![Recall against face height, precision against confidence](../docs/seeing.png)",
        "",
        "## By height of the face",
        "",
        "*candidate*: a box on it (IoU .5), if necessary after box regression; *classified*, *passed",
        "classifier*: one above the threshold of that model; *part of a sign*: one that is part of a row of",
        "`signs.parquet` (verdict `sign`). Signs seen in fewer than three images are not wanted, and many large",
        "faces stand where a drive begins: *of wanted* is the same without them.",
        "",
        *table(
            ("height", *HEAD),
            groups(faces, heights, lambda f: heights[bin_of(f.height_px, HEIGHTS)]),
        ),
        "",
        f"## By colour of the face, from {CLEAR_PX:g} px",
        "",
        *table(("colour", *HEAD), groups(clear, COLORS, lambda f: f.color)),
        "",
        "## Candidates",
        "",
        f"*covered*: fraction of faces from {CLEAR_PX:g} px with a candidate, and with one that is",
        "classified. Cost is processor time, in that of decoding one JPEG of the drive;",
        "the images of `raw` are not compressed.",
        "",
        *table(
            (
                "drive",
                "images",
                "faces",
                "candidates per image",
                "covered by a candidate",
                "classified",
                "by a classified one",
                "cost of proposing, decodes",
            ),
            [candidates_row(drive) for drive in seen],
        ),
        "",
        *confidence,
    ]
    return "\n".join(lines) + "\n"


def lost_lines(faces: Sequence[FaceOutcome]) -> Iterator[str]:
    """Every face of some height that is no part of a sign, with where it stopped."""
    for face in faces:
        if face.level < SIGN and face.height_px >= CLEAR_PX:
            box = ",".join(f"{v:.0f}" for v in face.box)
            where = f"{face.drive} frame {face.frame}  {box}  sign {face.sign}"
            words = (
                STOPPED[face.level] if face.wanted else f"{STOPPED[face.level]}, in too few images"
            )
            yield f"lost  {where}  {face.color} {face.kind}  {words}"


def candidates_row(drive: DriveOutcome) -> list[str]:
    """One drive: what proposing finds and costs."""
    clear = [face.level for face in drive.faces if face.height_px >= CLEAR_PX]
    faces, covered, passing = shares(clear, (CANDIDATE, CLASSIFIED))
    return [
        drive.name,
        str(drive.images),
        faces,
        f"{drive.candidates / drive.images:.0f}",
        covered,
        f"{drive.classified / drive.images:.0f}",
        passing,
        "-" if drive.decodes is None else f"{drive.decodes:.1f}",
    ]


def groups(
    faces: Sequence[FaceOutcome], names: Sequence[str], name_of: Callable[[FaceOutcome], str]
) -> Iterator[list[str]]:
    """One line a group that has faces, and one for all."""
    for name in (*names, "**all**"):
        own = [face for face in faces if name in (name_of(face), "**all**")]
        if own:
            wanted = shares((face.level for face in own if face.wanted), (SIGN,))[1:]
            yield [name.replace("_", " "), *shares((face.level for face in own), STAGES), *wanted]


if __name__ == "__main__":
    sys.exit(main())
