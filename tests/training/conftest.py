"""PyTorch takes seconds to import, and every process of the tests imports every file of them: a fixture imports it."""

import pytest


@pytest.fixture
def torch():
    found = pytest.importorskip(
        "torch", reason="PyTorch is only needed for learning: make .venv/.learn"
    )
    found.set_num_threads(1)
    return found
