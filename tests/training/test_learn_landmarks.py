"""Learning of the landmark classifiers: what it refuses, and what its models say of themselves."""

import numpy as np

from training.landmarks import SIGN, LandmarkSamples
from training.learn_landmarks import main, provenance
from wayside.stages.mapping import FEATURES


def test_a_folder_without_learning_drives_is_refused(tmp_path, capsys):
    assert main(["--drives", str(tmp_path), "-o", str(tmp_path)]) == 3
    assert "Render them first" in capsys.readouterr().err


def test_a_truth_that_is_missing_is_named(tmp_path, capsys):
    (tmp_path / "learn_a_500.mcap").write_bytes(b"")
    assert main(["--drives", str(tmp_path), "-o", str(tmp_path)]) == 3
    assert "learn_a_500.truth.json" in capsys.readouterr().err


def test_the_provenance_counts_the_landmarks_of_each_drive():
    drive = np.array([0, 1, 1, 0, 1])
    samples = LandmarkSamples(
        np.zeros((5, len(FEATURES)), np.float32),
        np.full(5, SIGN, np.int8),
        drive,
        drive > 9,
        np.full(5, ""),
        drive < 9,
    )
    words = provenance(["learn_a_500", "learn_b_500"], samples)
    assert "learn_a_500 (2 landmarks), learn_b_500 (3 landmarks)" in words
