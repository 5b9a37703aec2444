"""How a result compares with the truth of its drive; other packages take what they need from here."""

from wayside.pipeline.evaluation.compare import (
    evaluate,
    format_evaluation,
    other_log,
    write_evaluation,
)
from wayside.pipeline.evaluation.figures import (
    ConfidenceBin,
    Evaluation,
    KindCount,
    RealEvaluation,
    RenderedEvaluation,
    confidence_bin,
    together,
)
from wayside.pipeline.evaluation.misses import STEPS, cause_words, count_steps
from wayside.pipeline.evaluation.real import evaluate_against_labels
from wayside.pipeline.evaluation.rendered import (
    FEWEST_FRAMES,
    SMALLEST_HEIGHT_PX,
    SMALLEST_VISIBLE,
    camera_pose,
    evaluate_against_truth,
    is_eligible,
    match_distance,
)

__all__ = [
    "FEWEST_FRAMES",
    "SMALLEST_HEIGHT_PX",
    "SMALLEST_VISIBLE",
    "STEPS",
    "ConfidenceBin",
    "Evaluation",
    "KindCount",
    "RealEvaluation",
    "RenderedEvaluation",
    "camera_pose",
    "cause_words",
    "confidence_bin",
    "count_steps",
    "evaluate",
    "evaluate_against_labels",
    "evaluate_against_truth",
    "format_evaluation",
    "is_eligible",
    "match_distance",
    "other_log",
    "together",
    "write_evaluation",
]
