"""What the models of a run say of where they were learned: whether this log was among it."""

from __future__ import annotations

import re
from collections.abc import Mapping

from wayside.stages.classifiers import OnnxNetwork


def learned_from(log: str, provenances: Mapping[str, str]) -> tuple[str, ...]:
    """Names of the models whose provenance lists a log among its sources.

    Parameters
    ----------
    log
        Stem of the log's file name. A source is listed by it, maybe behind the name of a folder and a slash, and
        followed by how much it gave: `drive (60 images, ...` or `drive: 42 images`.
    provenances
        What each model says of itself, by the model's name.
    """
    source = re.compile(rf"(?<![^\s/;,]){re.escape(log)}(?: \(|: )\d")
    return tuple(name for name, text in provenances.items() if source.search(text))


def onnx_metadata(content: bytes) -> dict[str, str]:
    """Metadata of a network by the content of its ONNX file; none where it is not one."""
    try:
        return dict(OnnxNetwork(content).metadata)
    except ValueError:
        return {}
