"""What the command line sets for its process, and how it notices compilation."""

import gc
import json

from numba import njit

from wayside.pipeline.running.compilation import watched_compilation


def test_linear_algebra_runs_in_one_thread_whatever_the_machine(python):
    program = """
from threadpoolctl import threadpool_info
from wayside.pipeline.running.tuning import tune_process
tune_process()
print([pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"])
"""
    done = python(program, OPENBLAS_NUM_THREADS="4", OMP_NUM_THREADS="4")
    assert set(json.loads(done.stdout)) == {1}


def test_a_compilation_is_told_once_with_collection_paused():
    inner = njit(lambda x: x + 1)
    outer = njit(lambda x: inner(x) * 2)
    told = []
    with watched_compilation(lambda active: told.append((active, gc.isenabled()))):
        assert outer(2) == 6
        assert outer(3) == 8
    assert njit(lambda x: x - 1)(2) == 1  # outside of the block nothing is told
    assert told == [(True, False), (False, True)]
    assert gc.isenabled()
