"""What the command line sets for its whole process: threads of libraries, kept memory.

The library leaves all of this alone: a process belongs to the program that started it.
"""

import ctypes
import gc
from contextlib import suppress

import cv2
import scipy.linalg  # noqa: F401  (loads its linear algebra)
from threadpoolctl import threadpool_limits

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENAS = -1, -3, -8  # parameter numbers of glibc's malloc.h
_LARGEST_BLOCK = 32 << 20
_KEPT = 1 << 30


def tune_process() -> None:
    """Prepare a process that does nothing but process logs.

    The own threads of OpenCV and of the linear algebra are switched off, as the workers of a run share the cores
    already. A product of matrices has other last digits with other threads: without them, a result does not depend on
    the number of cores.
    """
    cv2.setNumThreads(1)
    # Acts on libraries that are loaded: those of numpy and scipy.
    threadpool_limits(1, user_api="blas")
    _keep_heap()
    gc.freeze()  # a million objects of modules, which stay: each search of them for garbage takes 0.1 s


def _keep_heap() -> None:
    """Ask the C library not to give the memory of each image back to the system.

    By default glibc maps every block of some megabytes again: about 1800 page faults for a 1600 x 1200 image, which
    makes decoding a half slower. All threads share one heap: with one each, what a thread frees stands idle, and a run
    takes 45 MB more. Other libraries have no such call or ignore it.
    """
    with suppress(AttributeError, OSError, TypeError):
        advise = ctypes.CDLL(None).mallopt
        advise.argtypes, advise.restype = (ctypes.c_int, ctypes.c_int), ctypes.c_int
        advise(_MMAP_THRESHOLD, _LARGEST_BLOCK)
        advise(_TRIM_THRESHOLD, _KEPT)
        advise(_ARENAS, 1)


def trim_heap() -> None:
    """Give freed memory back to the system: that of the images, which what comes after the last one does not need."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
