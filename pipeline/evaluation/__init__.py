"""How a result compares with the truth of its drive; other packages take what they need from here."""

from wayside.pipeline.evaluation.compare import (
    evaluate,
    format_evaluation,
    other_log,
    write_evaluation,
)
from wayside.pipeline.evaluation.figures import (
    Backs,
    Duplicate,
    Evaluation,
    FalseSign,
    KindCount,
    Match,
    MissCause,
    MissedPanel,
    RealEvaluation,
    RenderedEvaluation,
    together,
)
from wayside.pipeline.evaluation.misses import (
    STEPS,
    Candidates,
    Face,
    cause_words,
    count_steps,
    miss_causes,
)
from wayside.pipeline.evaluation.real import evaluate_against_labels
from wayside.pipeline.evaluation.reliability import ConfidenceBin, confidence_bin
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
    "Backs",
    "Candidates",
    "ConfidenceBin",
    "Duplicate",
    "Evaluation",
    "Face",
    "FalseSign",
    "KindCount",
    "Match",
    "MissCause",
    "MissedPanel",
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
    "miss_causes",
    "other_log",
    "together",
    "write_evaluation",
]
