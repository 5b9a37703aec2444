"""Road sign inventory from recorded drives: `run` a log, `open_inventory` of a run before.

docs/library.md shows the use. The parts `wayside.pipeline`, `wayside.stages` and `wayside.schemas` are the folders of
those names beside this one.
"""

import os as _os
from importlib.metadata import version as _version

# onnxruntime sends reports to its vendor unless this is set before its first import. Every way into wayside, processes
# of a fleet included, comes through here first; who has set it already has decided.
_os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

from wayside.pipeline.library import Inventory, Progress, open_inventory, run

__all__ = ["Inventory", "Progress", "__version__", "open_inventory", "run"]

__version__ = _version("wayside")
