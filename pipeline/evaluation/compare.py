"""Evaluate a result folder against the truth of its drive: read both, compare, and write the figures for a person."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from wayside.pipeline.evaluation import real, rendered
from wayside.pipeline.evaluation.figures import Evaluation, RealEvaluation, RenderedEvaluation, Row
from wayside.pipeline.evaluation.misses import (
    STEPS,
    Candidates,
    Face,
    cause_words,
    count_steps,
    miss_cause,
)
from wayside.pipeline.evaluation.real import evaluate_against_labels
from wayside.pipeline.evaluation.rendered import evaluate_against_truth
from wayside.pipeline.files.input_files import read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.files.writing import write_json
from wayside.pipeline.results.result import RUN_FILE, read_rows, read_run, read_table
from wayside.pipeline.statistics import Interval, Spread, share_interval
from wayside.schemas.errors import InputError
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

_SIGN_COLUMNS = (
    "sign_id status confidence color shape best_frame best_box right_m down_m ahead_m panel_width_m panel_height_m "
    "bottom_m sigma_lateral_m sigma_up_m sigma_along_m"
).split()
_TRUTH_KEYS = {"frames", "signs"}
_LABEL_KEYS = {"signs", "stride", "distractors"}


def evaluate(out: Path, truth: Path) -> Evaluation:
    """Figures of the result in folder `out`.

    `truth`: `truth.json` of a rendered drive or `labels.json` of a real one, told apart by what they hold. Raises
    InputError where one of them is missing, damaged or something else.
    """
    facts = _read_truth(truth)
    rows = read_rows(out, SIGNS, _SIGN_COLUMNS)
    frames = {row["frame"]: row["status"] for row in read_rows(out, FRAMES, ["frame", "status"])}
    learned_by = _run_of(out).get("learned_from_log")
    try:
        compare = _on_labels if _LABEL_KEYS <= facts.keys() else _on_truth
        evaluation, wrong, faces, candidates = compare(out, rows, facts)
    except CONTENT_FAULTS as error:
        raise InputError(
            f"truth file {truth}: an entry is not as expected ({type(error).__name__}: {error})"
        ) from error
    false = {row["sign_id"] for row in wrong.false}
    statuses = {row["sign_id"]: row["status"] for row in rows}
    return replace(
        evaluation,
        causes=tuple(miss_cause(face, candidates, frames, statuses) for face in faces),
        images=len(frames),
        learned_by=None if learned_by is None else tuple(map(str, learned_by)),
        stated=tuple(
            (row["confidence"], row["sign_id"] not in false) for row in _with_confidence(rows)
        ),
    )


_Compared = tuple[Evaluation, Evaluation, list[Face], Candidates]
"""Of the signs, and of all rows with a confidence; missed signs, and the candidates on them."""


def _on_truth(out: Path, rows: Sequence[Row], truth: Row) -> _Compared:
    signs, backs = ([row for row in rows if row["status"] == kind] for kind in ("sign", "back"))
    evaluation = evaluate_against_truth(signs, truth, backs)
    stated = evaluate_against_truth(_with_confidence(rows), truth)
    missed = rendered.missed_faces(evaluation, signs, truth)
    frames = {frame for face in missed for frame in face.views}
    return evaluation, stated, missed, _candidates(out, frames)


def _on_labels(out: Path, rows: Sequence[Row], labels: Row) -> _Compared:
    candidates = _candidates(out, real.labelled_frames(labels))
    seen = candidates.of_signs()
    signs = [row for row in rows if row["status"] == "sign"]
    evaluation = evaluate_against_labels(signs, seen, labels)
    stated = evaluate_against_labels(_with_confidence(rows), seen, labels)
    return evaluation, stated, real.missed_faces(evaluation, labels), candidates


def _with_confidence(rows: Sequence[Row]) -> list[Row]:
    """Rows of signs, uncertain ones among them, that state a confidence."""
    kinds = ("sign", "uncertain")
    return [row for row in rows if row["status"] in kinds and row["confidence"] is not None]


def _candidates(out: Path, frames: Collection[int]) -> Candidates:
    return Candidates(read_table(out, OBSERVATIONS, Candidates.COLUMNS, {"frame": frames}))


def _run_of(out: Path) -> dict[str, Any]:
    return read_run(out) if (out / RUN_FILE).is_file() else {}


def other_log(out: Path, truth: Path) -> str | None:
    """That the truth states to be of another log than the result is of, in words; None where it does not."""
    logs = _read_truth(truth).get("log", ""), _run_of(out).get("log", "")
    of_truth, of_run = (Path(str(one)).stem for one in logs)
    if not of_truth or not of_run or of_truth == of_run:
        return None
    return f"{truth} says that it is of {of_truth}, the result in {out} is of {of_run}"


def write_evaluation(evaluation: Evaluation, file: Path, *, overwrite: bool = False) -> None:
    """Write the figures as JSON. They replace those of an earlier evaluation or, with `overwrite`, any file.

    Raises OutputError where the file cannot be written, or something else has its name.
    """
    write_json(file, evaluation.to_json(), ("wanted", "found_count", "false"), overwrite=overwrite)


def format_evaluation(evaluation: Evaluation) -> str:
    """All figures as plain text."""
    sections = [_shares(evaluation)]
    if isinstance(evaluation, RenderedEvaluation):
        backs = evaluation.backs
        said = f"backs      {backs.right} of {backs.reported} right, {backs.in_view} in view"
        sections += [_errors(evaluation), _classes(evaluation), [said]]
    elif isinstance(evaluation, RealEvaluation):
        sections.append(_kinds(evaluation))
    sections += [_reliability(evaluation), *_false(evaluation), *_missed(evaluation)]
    return "\n\n".join("\n".join(lines) for lines in sections if lines)


def _shares(e: Evaluation) -> list[str]:
    recall, precision = _between(e.recall_interval), _between(e.precision_interval)
    lines = [f"recall     {e.recall:.3f}   {e.found_count} of {e.wanted} found{recall}"]
    rate = ""
    if e.false_per_100_images is not None:
        rate = f"; {e.false_per_100_images:.2f} per 100 images"
        rate += _between(e.false_per_100_images_interval, places=2)
    rows = f"precision  {e.precision:.3f}   {e.right} of {e.counted} rows"
    count, twice = len(e.false), len(e.duplicates)
    if isinstance(e, RenderedEvaluation):
        others = count - twice
        lines.append(f"{rows}{precision}")
        lines.append(f"false      {count:<5}   duplicates {twice}, others {others}{rate}")
    else:
        better = f"of the {e.right} rows on a label: it has another, better one"
        lines.append(f"{rows} on a label{precision}; at least, labels are not complete")
        lines.append(f"false      {count:<5}   on no label{rate}")
        lines.append(f"duplicates {twice:<5}   {better}")
    if e.learned_by is not None:
        lines.append(
            f"learned    {', '.join(e.learned_by) or 'no model'} of this run from this log"
        )
    return lines


def _kinds(evaluation: RealEvaluation) -> list[str]:
    rows = [
        f"{kind.kind:<44}{kind.wanted:>7}{kind.found:>7}{_share(kind.found, kind.wanted)}"
        for kind in evaluation.kinds
    ]
    return [f"{'kind':<44}{'wanted':>7}{'found':>7}{'recall':>8}   95 %", *rows] if rows else []


def _reliability(evaluation: Evaluation) -> list[str]:
    right = "right" if isinstance(evaluation, RenderedEvaluation) else "on a label"
    head = f"{'rows of confidence':<20}{'rows':>6}{'mean':>8}{right:>12}{'share':>8}   95 %"
    rows = [
        f"{one.name:<20}{one.rows:>6}{one.mean:>8.3f}{one.right:>12}{_share(one.right, one.rows)}"
        for one in evaluation.reliability
    ]
    return [head, *rows] if rows else []


def _errors(evaluation: RenderedEvaluation) -> list[str]:
    rows: dict[str, Spread] = {
        f"{axis}, m": evaluation.error_m[axis] for axis in ("along", "lateral", "up", "total")
    }
    rows |= {
        "width, share": evaluation.size_error("width"),
        "height, share": evaluation.size_error("height"),
        "bottom edge, m": evaluation.bottom_error_m,
    }
    head = f"{'error of found':<18}{'n':>5}{'median':>9}{'95 %':>9}"
    lines = [f"{head}{'in 1 sigma':>12}{'in 2 sigma':>12}"]
    for name, error in rows.items():
        line = f"{name:<18}{error.n:>5}{_number(error.median):>9}{_number(error.p95):>9}"
        sigma = evaluation.sigma_share.get(name.removesuffix(", m"))
        if sigma is not None:
            line += f"{_percent(sigma.one):>12}{_percent(sigma.two):>12}"
        lines.append(line)
    return lines


def _classes(evaluation: RenderedEvaluation) -> list[str]:
    lines = []
    for title, name in (("colour right", "color"), ("shape right", "shape")):
        pairs = evaluation.confusion(name).items()
        wrong = [f"{pair} ({count})" for pair, count in pairs if len(set(pair.split(" -> "))) > 1]
        more = f"   wrong: {', '.join(wrong)}" if wrong else ""
        lines.append(f"{title:<14}{_percent(evaluation.class_right(name)):>6}{more}")
    return lines


def _false(evaluation: Evaluation) -> Iterator[list[str]]:
    """The duplicates, and the other false rows."""
    twice = {one.sign_id: one for one in evaluation.duplicates}
    if twice:
        yield [
            "duplicates",
            *(f"  {o.sign_id}  of {o.better}, on sign {o.panel}" for o in twice.values()),
        ]
    others = [
        f"  {row['sign_id']}  frame {row['best_frame']}  {row['color'] or '?'} {row['shape'] or '?'}  "
        f"on: {row['cause']}"
        for row in evaluation.false
        if row["sign_id"] not in twice
    ]
    if others:
        yield ["false", *others]


def _missed(evaluation: Evaluation) -> Iterator[list[str]]:
    """The signs that were missed with their causes, and the steps that lost them."""
    causes = {cause.id: cause_words(cause) for cause in evaluation.causes}
    lines = ["missed"]
    for one in evaluation.missed:
        if isinstance(evaluation, RealEvaluation):
            lines.append(f"  {one:<6}  {causes.get(one, '')}".rstrip())
            continue
        face = f"{one['kind']}, {one['color']} {one['shape']}"
        size = f"{_number(one['width_m'])} x {_number(one['height_m'])} m"
        where = f"{_number(one['station_m'])} m along, {_number(one['lateral_m'])} m right"
        lines.append(f"  {one['id']:>4}  {face:<44} {size}   {where}")
        if one["id"] in causes:
            lines.append(f"        {causes[one['id']]}")
    if evaluation.missed:
        yield lines
    if len(causes) > 1:
        steps = count_steps(evaluation.causes).items()
        counts = (f"  {count:>4}  {STEPS[step]}" for step, count in steps)
        yield ["missed, by the step that lost them", *counts]


def _share(count: int, total: int) -> str:
    """A share and its interval, as the last cells of a row."""
    return f"{count / total:>8.3f}   {_ends(share_interval(count, total))}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _between(interval: Interval | None, places: int = 3) -> str:
    return "" if interval is None else f", 95 %: {_ends(interval, places)}"


def _ends(interval: Interval | None, places: int = 3) -> str:
    return "-" if interval is None else f"{interval.low:.{places}f} to {interval.high:.{places}f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _read_truth(file: Path) -> dict[str, Any]:
    try:
        facts = parse_json(read_input_text(file))
    except OSError as error:
        raise InputError(f"truth file {file} cannot be read: {error.strerror}") from error
    except ValueError as error:
        if file.suffix.lower() == ".csv":
            raise InputError(
                f"{file}: a review must be a table with a column `review` and no row longer than its first. See "
                "docs/corrections.md."
            ) from error
        raise InputError(f"truth file {file} is not JSON: {error}") from error
    keys = facts.keys() if isinstance(facts, dict) else set()
    if not (_TRUTH_KEYS <= keys or _LABEL_KEYS <= keys):
        raise InputError(
            f"{file} is neither the truth of a rendered drive (frames, signs) nor labels of a real one "
            "(signs, stride, distractors)"
        )
    return dict(facts)
