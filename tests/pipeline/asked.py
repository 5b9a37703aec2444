"""Tables of what a classifier was asked, made by hand."""

import numpy as np

from wayside.pipeline.learning.asked import ClassifierSamples


def asked(label, values, classifier="color", space="rgb", **columns):
    """Samples, one a frame, of four drives in turn unless `columns` say otherwise."""
    n = len(label)
    named = np.array(columns.get("named", [""] * n))
    given = {
        "kind": [""] * n,
        "accepted": named != "",
        "named": named,
        "drive": [f"d{i % 4}" for i in range(n)],
        "frame": np.arange(n),
        "box": np.zeros((n, 4)),
        "count": np.ones(n),
    } | columns
    kinds = {"accepted": bool, "frame": np.int32, "box": np.float32, "count": np.int64}
    rest = {name: np.array(one, kinds.get(name)) for name, one in given.items()}
    values = np.asarray(values, np.float64).reshape(n, -1)
    return ClassifierSamples(classifier, space, values, np.array(label, np.int8), **rest)
