import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection.stacked_regions import stacked_pairs

boxes = st.lists(
    st.tuples(st.floats(-50, 400), st.floats(-50, 300), st.floats(1, 300), st.floats(1, 300)),
    max_size=60,
)


def as_boxes(rows):
    table = np.array(rows, np.float32).reshape(-1, 4)
    table[:, 2:] += table[:, :2]
    return table


@settings(max_examples=60)
@given(boxes)
def test_stacked_pairs_are_those_of_the_plain_comparison_of_all_pairs(rows):
    box = as_boxes(np.round(rows).tolist() if rows else rows)
    wanted = set()
    for i in range(len(box)):
        for j in range(i + 1, len(box)):
            a, b = (i, j) if box[i, 1] + box[i, 3] < box[j, 1] + box[j, 3] else (j, i)
            edge = max(0.15 * min(box[i, 2] - box[i, 0], box[j, 2] - box[j, 0]), 1.5)
            tall = min(box[i, 3] - box[i, 1], box[j, 3] - box[j, 1])
            apart = box[b, 1] - box[a, 3]
            near = np.abs(box[i, [0, 2]] - box[j, [0, 2]]).max() <= edge
            if near and -0.35 * tall <= apart <= max(0.35 * tall, 2.0):
                wanted.add(frozenset((i, j)))
    assert {frozenset(pair) for pair in stacked_pairs(box, CandidateSettings()).tolist()} == wanted
