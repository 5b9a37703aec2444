"""Road sign inventory from recorded drives: `run` a log, `open_inventory` of a run before.

The checkout is the package: this file is `wayside/__init__.py`, the folders beside it its parts. docs/library.md shows
the use.
"""

from importlib.metadata import version as _version

from wayside.pipeline.library import Inventory, Progress, open_inventory, run

__all__ = ["Inventory", "Progress", "__version__", "open_inventory", "run"]

__version__ = _version("wayside")
