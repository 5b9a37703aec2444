"""What the command line sets for its whole process: threads of libraries, the search for garbage.

The library leaves all of this alone: a process belongs to the program that started it.
"""

import gc

import cv2
import scipy.linalg  # noqa: F401  (loads its linear algebra)
from threadpoolctl import threadpool_limits


def tune_process() -> None:
    """Prepare a process that does nothing but process logs.

    The own threads of OpenCV and of the linear algebra are switched off, as the workers of a run share the cores
    already. A product of matrices has other last digits with other threads: without them, a result does not depend on
    the number of cores.
    """
    cv2.setNumThreads(1)
    # Acts on libraries that are loaded: those of numpy and scipy.
    threadpool_limits(1, user_api="blas")
    gc.freeze()  # a million objects of modules, which stay: each search of them for garbage takes 0.1 s
