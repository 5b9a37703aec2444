"""Kernels compile wherever they are installed."""

import threading
from pathlib import Path

import pytest

from wayside.pipeline.running.compilation import compiled_ahead
from wayside.stages.kernels import compiled

RECORDINGS = Path(__file__).parents[2] / "recordings"


def test_a_kernel_without_a_file_to_cache_beside_still_compiles():
    namespace = {}
    exec("def double(x):\n    return 2 * x\n", namespace)
    assert compiled(namespace["double"])(4) == 8


@compiled
def _count(n):
    total = 0
    for i in range(n):
        total += i % 3
    return total


def test_a_kernel_may_be_compiled_from_two_threads_at_once():
    results = []
    threads = [threading.Thread(target=lambda: results.append(_count(1000))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [sum(i % 3 for i in range(1000))] * 2


VERSION = """
from typing import NamedTuple
from wayside.stages.kernels import compiled

class {name}(NamedTuple):
    value: float

@compiled
def doubled(one):
    return 2 * one.value

print(doubled({name}(4.0)))
"""


def test_a_kernel_compiled_by_an_earlier_version_of_the_code_is_compiled_again(python, tmp_path):
    code, kept = tmp_path / "version.py", {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    for name in ("Before", "After"):
        code.write_text(VERSION.format(name=name))
        assert python("import version", cwd=tmp_path, **kept).stdout == "8.0\n"


CALLED = """
import sys
from wayside.pipeline.cli import app
app(["run", sys.argv[1], "-o", sys.argv[2]], standalone_mode=False)
print("called:")
for name, module in sorted(sys.modules.items()):
    if name.startswith("wayside.stages."):
        for function in vars(module).values():
            if getattr(function, "__module__", "") == name and hasattr(function, "stats"):
                for types in [s for s in function.signatures if function.stats.cache_path]:
                    print(name, function.__name__, types)
"""
"""Prints types of the kernels that a run has called."""


@pytest.mark.slow
def test_the_kernels_of_a_run_are_those_that_another_process_compiles_ahead(python, tmp_path):
    for _ in range(2):  # at first kernels that only others call are compiled, too
        done = python(CALLED, RECORDINGS / "demo.mcap", tmp_path)
    called = set(done.stdout.partition("called:\n")[2].splitlines())
    ahead = {f"{one.__module__} {one.__name__} {types}" for one, types in compiled_ahead()}
    assert called <= ahead
    assert len(called) > 0.8 * len(ahead)  # others need fixes, or a longer drive


@pytest.mark.slow
def test_another_process_compiles_from_the_last_kernel_on(python, tmp_path):
    program = """
import sys, time
from pathlib import Path
import numpy as np
from wayside.pipeline.running.compilation import watched_compilation
from wayside.stages.geometry.rotation import tangent_basis
with watched_compilation(lambda active: None):
    tangent_basis(np.array([0.0, 0.0, 1.0]))
    while not [*Path(sys.argv[1]).rglob(f"{sys.argv[2]}-*.nbi")]:
        time.sleep(0.1)
"""
    last, _ = compiled_ahead()[-1]
    name = f"{last.__module__.rpartition('.')[2]}.{last.__name__}"
    python(program, tmp_path, name, NUMBA_CACHE_DIR=str(tmp_path))
