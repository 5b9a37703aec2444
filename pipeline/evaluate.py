"""Evaluate a result folder against the truth of its drive: read both, compare, and write the figures for a person."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from wayside.pipeline.evaluate_real import evaluate_against_labels
from wayside.pipeline.evaluate_rendered import evaluate_against_truth
from wayside.pipeline.evaluation import Evaluation, RealEvaluation, RenderedEvaluation, Spread
from wayside.pipeline.result import read_rows
from wayside.pipeline.writing import write_json
from wayside.schemas.errors import InputError
from wayside.schemas.tables import OBSERVATIONS, SIGNS

_SIGN_COLUMNS = (
    "sign_id status color shape best_frame best_box right_m down_m ahead_m panel_width_m panel_height_m bottom_m "
    "sigma_lateral_m sigma_up_m sigma_along_m"
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
    signs, backs = ([row for row in rows if row["status"] == kind] for kind in ("sign", "back"))
    try:
        if _LABEL_KEYS <= facts.keys():
            observations = read_rows(out, OBSERVATIONS, ["sign_id", "frame", "box"])
            return evaluate_against_labels(signs, observations, facts)
        return evaluate_against_truth(signs, facts, backs)
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise InputError(
            f"truth file {truth}: an entry is not as expected ({type(error).__name__}: {error})"
        ) from error


def write_evaluation(evaluation: Evaluation, file: Path, *, overwrite: bool = False) -> None:
    """Write the figures as JSON, over those of an earlier evaluation or, with `overwrite`, whatever stands there.

    Raises
    ------
    OutputError
        The file cannot be written, or something else stands there.
    """
    content = evaluation.to_json()
    write_json(file, content, ("wanted", "found_count", "false"), overwrite=overwrite)


def format_evaluation(evaluation: Evaluation) -> str:
    """All figures as plain text."""
    lines = [
        f"recall     {evaluation.recall:.3f}   {evaluation.found_count} of {evaluation.wanted} found",
        f"precision  {evaluation.precision:.3f}   {len(evaluation.false)} false",
    ]
    if isinstance(evaluation, RenderedEvaluation):
        lines += ["", *_error_lines(evaluation), "", *_class_lines(evaluation)]
        seen = evaluation.backs
        lines += ["", f"backs      {seen.right} of {seen.reported} right, {seen.in_view} in view"]
    lines += _false_lines(evaluation)
    if evaluation.missed:
        lines += ["", "missed"]
    if isinstance(evaluation, RealEvaluation):
        lines += [f"  {name}" for name in evaluation.missed]
        return "\n".join(lines)
    for panel in evaluation.missed:
        face = f"{panel.kind}, {panel.color} {panel.shape}"
        size = f"{_number(panel.width_m)} x {_number(panel.height_m)} m"
        where = f"{_number(panel.station_m)} m along, {_number(panel.lateral_m)} m right"
        lines.append(f"  {panel.id:>4}  {face:<44} {size}   {where}")
    return "\n".join(lines)


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
        wrong = [
            f"{pair} ({count})" for pair, count in pairs.items() if len(set(pair.split(" -> "))) > 1
        ]
        yield f"{name + ' right':<14}{_percent(right):>6}" + (
            f"   wrong: {', '.join(wrong)}" if wrong else ""
        )


def _false_lines(evaluation: Evaluation) -> Iterator[str]:
    if evaluation.false:
        yield ""
        yield "false"
    for sign in evaluation.false:
        face = f"{sign.color or '?'} {sign.shape or '?'}"
        yield f"  {sign.sign_id}  frame {sign.best_frame}  {face}  on: {sign.cause}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _read_truth(file: Path) -> dict[str, Any]:
    try:
        facts = json.loads(file.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"truth file {file} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"truth file {file} is not JSON: {error}") from error
    keys = facts.keys() if isinstance(facts, dict) else set()
    if not (_TRUTH_KEYS <= keys or _LABEL_KEYS <= keys):
        raise InputError(
            f"{file} is neither the truth of a rendered drive (frames, signs) nor labels of a real one "
            "(signs, stride, distractors)"
        )
    return dict(facts)
