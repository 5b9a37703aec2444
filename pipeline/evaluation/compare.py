"""Evaluate a result folder against the truth of its drive: read both, compare, and write the figures for a person."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from wayside.pipeline.evaluation import real, rendered
from wayside.pipeline.evaluation.figures import (
    Evaluation,
    FalseSign,
    RealEvaluation,
    RenderedEvaluation,
    Row,
)
from wayside.pipeline.evaluation.misses import (
    STEPS,
    Candidates,
    Distances,
    Face,
    cause_words,
    count_steps,
    miss_causes,
)
from wayside.pipeline.evaluation.reliability import reliability
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

    Parameters
    ----------
    out
        Folder written by `wayside run`.
    truth
        `truth.json` of a rendered drive or `labels.json` of a real one, told apart by what they hold.

    Raises
    ------
    InputError
        One of them is missing, damaged or something else.
    """
    facts = _read_truth(truth)
    rows = read_rows(out, SIGNS, _SIGN_COLUMNS)
    frames = {row["frame"]: row["status"] for row in read_rows(out, FRAMES, ["frame", "status"])}
    learned_by = _run_of(out).get("learned_from_log")
    try:
        compare = _on_labels if _LABEL_KEYS <= facts.keys() else _on_truth
        evaluation, wrong, faces, candidates, distances = compare(out, rows, facts)
    except CONTENT_FAULTS as error:
        raise InputError(
            f"truth file {truth}: an entry is not as expected ({type(error).__name__}: {error})"
        ) from error
    statuses = {row["sign_id"]: row["status"] for row in rows}
    return replace(
        evaluation,
        causes=miss_causes(faces, candidates, frames, statuses, distances),
        reliability=reliability(_with_confidence(rows), {row.sign_id for row in wrong}),
        images=len(frames),
        learned_by=None if learned_by is None else tuple(map(str, learned_by)),
    )


def other_log(out: Path, truth: Path) -> str | None:
    """That the truth states to be of another log than the result is of, in words; None where it does not."""
    facts = _read_truth(truth)
    logs = facts.get("log", ""), _run_of(out).get("log", "")
    of_truth, of_run = (Path(str(one)).stem for one in logs)
    if not of_truth or not of_run or of_truth == of_run:
        return None
    return f"{truth} says that it is of {of_truth}, the result in {out} is of {of_run}"


_Compared = tuple[Evaluation, tuple[FalseSign, ...], list[Face], Candidates, Distances]
"""Figures; those rows with a confidence that are false; missed signs, candidates on them, and distances of rows."""


def _on_truth(out: Path, rows: Sequence[Row], truth: Row) -> _Compared:
    signs, backs = ([row for row in rows if row["status"] == kind] for kind in ("sign", "back"))
    evaluation = rendered.evaluate_against_truth(signs, truth, backs)
    missed = rendered.missed_faces(evaluation, truth)
    candidates = _candidates(out, {frame for face in missed for frame in face.views})
    wrong = rendered.evaluate_against_truth(_with_confidence(rows), truth).false
    return evaluation, wrong, missed, candidates, rendered.false_distances(evaluation, signs, truth)


def _on_labels(out: Path, rows: Sequence[Row], labels: Row) -> _Compared:
    candidates = _candidates(out, real.labelled_frames(labels))
    signs = [row for row in rows if row["status"] == "sign"]
    evaluation, stated = (
        real.evaluate_against_labels(some, candidates.of_signs(), labels)
        for some in (signs, _with_confidence(rows))
    )
    return evaluation, stated.false, real.missed_faces(evaluation, labels), candidates, {}


def _run_of(out: Path) -> dict[str, Any]:
    return read_run(out) if (out / RUN_FILE).is_file() else {}


def _with_confidence(rows: Sequence[Row]) -> list[Row]:
    """Rows of signs, uncertain ones among them, that state a confidence."""
    kinds = ("sign", "uncertain")
    return [row for row in rows if row["status"] in kinds and row["confidence"] is not None]


def _candidates(out: Path, frames: Collection[int]) -> Candidates:
    return Candidates(read_table(out, OBSERVATIONS, Candidates.COLUMNS, {"frame": frames}))


def write_evaluation(evaluation: Evaluation, file: Path, *, overwrite: bool = False) -> None:
    """Write the figures as JSON. They replace those of an earlier evaluation or, with `overwrite`, any file.

    Raises
    ------
    OutputError
        The file cannot be written, or something else stands there.
    """
    content = evaluation.to_json()
    write_json(file, content, ("wanted", "found_count", "false"), overwrite=overwrite)


def format_evaluation(evaluation: Evaluation) -> str:
    """All figures as plain text."""
    lines = list(_share_lines(evaluation))
    if isinstance(evaluation, RenderedEvaluation):
        lines += ["", *_error_lines(evaluation), "", *_class_lines(evaluation)]
        seen = evaluation.backs
        lines += ["", f"backs      {seen.right} of {seen.reported} right, {seen.in_view} in view"]
    else:
        lines += _kind_lines(evaluation)
    lines += _reliability_lines(evaluation)
    return "\n".join([*lines, *_false_lines(evaluation), *_missed_lines(evaluation)])


def _share_lines(evaluation: Evaluation) -> Iterator[str]:
    e = evaluation
    yield f"recall     {e.recall:.3f}   {e.found_count} of {e.wanted} found{_between(e.recall_interval)}"
    precision, between = f"precision  {e.precision:.3f}", _between(e.precision_interval)
    rate = ""
    if e.false_per_100_images is not None:
        rate = f"; {e.false_per_100_images:.2f} per 100 images"
        rate += _between(e.false_per_100_images_interval, places=2)
    twice = len(e.duplicates)
    if isinstance(e, RenderedEvaluation):
        yield f"{precision}   {e.right} of {e.counted} rows{between}"
        yield f"false      {len(e.false):<5}   duplicates {twice}, others {len(e.others)}{rate}"
    else:
        yield f"{precision}   {e.right} of {e.counted} rows on a label{between}; at least, labels are not complete"
        yield f"false      {len(e.false):<5}   on no label{rate}"
        yield f"duplicates {twice:<5}   of the {e.right} rows on a label: it has another, better one"
    if e.learned_by is not None:
        yield f"learned    {', '.join(e.learned_by) or 'no model'} of this run from this log"


def _kind_lines(evaluation: RealEvaluation) -> Iterator[str]:
    if evaluation.kinds:
        yield ""
        yield f"{'kind':<44}{'wanted':>7}{'found':>7}{'recall':>8}   95 %"
    for kind in evaluation.kinds:
        share, interval = kind.found / kind.wanted, share_interval(kind.found, kind.wanted)
        counts = f"{kind.wanted:>7}{kind.found:>7}{share:>8.3f}"
        yield f"{kind.kind:<44}{counts}   {_ends(interval)}"


def _reliability_lines(evaluation: Evaluation) -> Iterator[str]:
    if evaluation.reliability:
        right = "right" if isinstance(evaluation, RenderedEvaluation) else "on a label"
        yield ""
        yield f"{'rows of confidence':<20}{'rows':>6}{'mean':>8}{right:>12}{'share':>8}   95 %"
    for one in evaluation.reliability:
        interval, share = share_interval(one.right, one.rows), one.right / one.rows
        counts = f"{one.rows:>6}{one.mean:>8.3f}{one.right:>12}{share:>8.3f}"
        yield f"{one.name:<20}{counts}   {_ends(interval)}"


def _missed_lines(evaluation: Evaluation) -> Iterator[str]:
    if not evaluation.missed:
        return
    yield ""
    yield "missed"
    causes = {cause.id: cause_words(cause) for cause in evaluation.causes}
    if isinstance(evaluation, RealEvaluation):
        for name in evaluation.missed:
            yield f"  {name:<6}  {causes.get(name, '')}".rstrip()
    else:
        for panel in evaluation.missed:
            face = f"{panel.kind}, {panel.color} {panel.shape}"
            size = f"{_number(panel.width_m)} x {_number(panel.height_m)} m"
            where = f"{_number(panel.station_m)} m along, {_number(panel.lateral_m)} m right"
            yield f"  {panel.id:>4}  {face:<44} {size}   {where}"
            if panel.id in causes:
                yield f"        {causes[panel.id]}"
    if len(evaluation.causes) > 1:
        yield ""
        yield "missed, by the step that lost them"
        for step, count in count_steps(evaluation.causes).items():
            yield f"  {count:>4}  {STEPS[step]}"


def _error_lines(evaluation: RenderedEvaluation) -> Iterator[str]:
    rows: list[tuple[str, Spread]] = [
        (f"{name}, m", evaluation.error_m[name]) for name in ("along", "lateral", "up", "total")
    ]
    rows += [
        ("width, share", evaluation.width_error),
        ("height, share", evaluation.height_error),
        ("bottom edge, m", evaluation.bottom_error_m),
    ]
    yield f"{'error of found':<18}{'n':>5}{'median':>9}{'95 %':>9}{'in 1 sigma':>12}{'in 2 sigma':>12}"
    for name, spread in rows:
        line = f"{name:<18}{spread.n:>5}{_number(spread.median):>9}{_number(spread.p95):>9}"
        sigma = evaluation.sigma_share.get(name.removesuffix(", m"))
        if sigma is not None:
            line += f"{_percent(sigma.one):>12}{_percent(sigma.two):>12}"
        yield line


def _class_lines(evaluation: RenderedEvaluation) -> Iterator[str]:
    for name, right, pairs in (
        ("colour", evaluation.color_right, evaluation.color_confusion),
        ("shape", evaluation.shape_right, evaluation.shape_confusion),
    ):
        wrong = [f"{p} ({n})" for p, n in pairs.items() if len(set(p.split(" -> "))) > 1]
        more = f"   wrong: {', '.join(wrong)}" if wrong else ""
        yield f"{name + ' right':<14}{_percent(right):>6}{more}"


def _false_lines(evaluation: Evaluation) -> Iterator[str]:
    rows = [f"{row.sign_id}  of {row.better}, on sign {row.panel}" for row in evaluation.duplicates]
    if rows:
        yield from ("", "duplicates", *(f"  {row}" for row in rows))
    others = [
        f"{one.sign_id}  frame {one.best_frame}  {one.color or '?'} {one.shape or '?'}  on: {one.cause}"
        for one in evaluation.others
    ]
    if others:
        yield from ("", "false", *(f"  {row}" for row in others))


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
