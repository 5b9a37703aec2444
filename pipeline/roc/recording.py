"""The curves for the viewer: one plot a classifier, and the figures as a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from wayside.pipeline.roc.curves import RocCurve
from wayside.pipeline.roc.pictures import ink_of
from wayside.pipeline.roc.questions import Question

# before rerun itself: it says what to install where that is absent
from wayside.pipeline.view.entities import APPLICATION


def record_curves(
    path: Path, drawn: Mapping[str, Sequence[tuple[Question, RocCurve]]], page: str
) -> None:
    """Write a recording: TPR upwards against FPR of each classifier, knees and thresholds as points; `page` as text.

    Parameters
    ----------
    path
        The .rrd file to make.
    drawn
        Curves by classifier.
    page
        All figures, Markdown.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    plots = [rrb.Spatial2DView(origin=f"/roc/{name}", name=f"ROC of {name}") for name in drawn]
    layout = rrb.Blueprint(
        rrb.Horizontal(rrb.Grid(*plots), rrb.TextDocumentView(origin="/figures", name="figures")),
        collapse_panels=True,
    )
    stream = rr.RecordingStream(APPLICATION, recording_id="roc")
    stream.save(path, default_blueprint=layout)
    stream.log("/figures", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN), static=True)
    for name, curves in drawn.items():
        frame = rr.LineStrips2D(
            [[(0, 0), (1, 0), (1, -1), (0, -1), (0, 0)], [(0, 0), (1, -1)]],
            colors=[(120, 120, 120)],
            radii=0.001,
        )
        stream.log(f"/roc/{name}/axes", frame, static=True)
        for row, (question, curve) in enumerate(curves):
            ink = ink_of(question.name, row)
            line = np.stack([np.append(curve.fpr, 1.0), -np.append(curve.tpr, 1.0)], axis=1)
            at = question.used_row(curve)
            shown = {"knee": curve.knee} if at is None else {"knee": curve.knee, "threshold": at}
            entity = f"/roc/{name}/{question.name}"
            strips = rr.LineStrips2D([line], colors=[ink], radii=0.003, labels=[question.name])
            stream.log(f"{entity}/curve", strips, static=True)
            marks = rr.Points2D(
                line[list(shown.values())],
                colors=[ink],
                radii=[0.008, 0.012][: len(shown)],
                labels=list(shown),
                show_labels=False,
            )
            stream.log(f"{entity}/points", marks, static=True)
    stream.flush()
    stream.disconnect()
