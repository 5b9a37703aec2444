"""Kernels compile wherever they are installed."""

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
