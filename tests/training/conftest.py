"""Tests of programs that are not installed: all are slow. PyTorch takes seconds to import, so a fixture imports it."""

from pathlib import Path

import pytest


@pytest.hookimpl(tryfirst=True)  # before pytest leaves out what is slow
def pytest_collection_modifyitems(items):
    """Marks the tests of this folder."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def torch():
    found = pytest.importorskip("torch", reason="only needed for learning: make .venv/.learn")
    found.set_num_threads(1)
    return found
