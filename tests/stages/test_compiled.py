"""Kernels compile wherever they are installed."""

import os
import subprocess
import sys
import threading

from wayside.stages.kernels import compiled


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


def test_a_kernel_compiled_by_an_earlier_version_of_the_code_is_compiled_again(tmp_path):
    code, kept = tmp_path / "version.py", os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    for name in ("Before", "After"):
        code.write_text(VERSION.format(name=name))
        command = [sys.executable, "-c", "import version"]
        done = subprocess.run(command, cwd=tmp_path, env=kept, capture_output=True, text=True)
        assert done.stdout == "8.0\n", done.stderr
