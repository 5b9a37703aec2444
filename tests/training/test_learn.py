"""The learning of where signs stand and of outlines, as a command."""

from pathlib import Path

import numpy as np
import pytest

from training.learn import main
from training.outlines import FEWEST
from wayside.pipeline.learning.truth import location_model
from wayside.pipeline.models.model_files import shipped_models
from wayside.pipeline.models.model_json import model_from_json
from wayside.schemas.errors import OutputError

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"


def test_the_models_that_ship_are_not_written_over_while_they_are_in_use(tmp_path, capsys):
    shipped = str(shipped_models())
    assert main(["--drives", str(tmp_path), "-o", shipped]) == OutputError.exit_status
    assert f"{shipped}: this is the folder of the models that ship" in capsys.readouterr().err


def test_a_folder_without_learning_drives_is_refused(tmp_path, capsys):
    assert main(["--drives", str(tmp_path), "-o", str(tmp_path)]) == 3
    assert "learn_*.mcap" in capsys.readouterr().err


def test_signs_stand_right_left_and_above_of_the_road():
    random = np.random.default_rng(2)
    right, left = random.normal((6, 0.5), 0.5, (50, 2)), random.normal((-8, 0.5), 0.5, (20, 2))
    above = [(0, 4.5), (1, 4.6), (3, 4.4), (-1, 4.5)]
    model = location_model(np.concatenate([right, left, above]), "made by hand")
    assert [one.name for one in model.classes] == ["right", "left", "overhead"]
    assert model.classes[0].mean == pytest.approx([6, 0.5], abs=0.3)


@pytest.mark.slow
def test_both_models_say_what_they_were_learned_from_and_are_the_same_again(tmp_path):
    for name in ("a", "b"):  # one alone has too few faces
        for ending in (".mcap", ".truth.json"):
            (tmp_path / f"learn_{name}{ending}").symlink_to(DEMO.with_suffix(ending))
    texts = []
    for name in ("one", "same"):
        assert main(["--drives", str(tmp_path), "-o", str(tmp_path / name)]) == 0
        texts.append(
            [(tmp_path / name / f"{one}.json").read_text() for one in ("location", "outline")]
        )
    assert texts[0] == texts[1]
    location, outline = map(model_from_json, texts[0])
    assert "rendered drives demo (" in location.provenance
    assert "seed 1" in outline.provenance
    assert int(outline.provenance.split(" faces")[0].split()[-1]) >= FEWEST
