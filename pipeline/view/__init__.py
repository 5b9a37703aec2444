"""Every intermediate result in the Rerun viewer: what it looks like, where it goes, how it is laid out.

Nothing else needs Rerun, which is large: tables are made without it, and whoever asks for the viewer is told.
"""

from importlib.util import find_spec

from wayside.schemas.errors import UsageError

if find_spec("rerun") is None:
    raise UsageError(
        "wanted Rerun to record, view or draw the steps of a run, found it not installed; "
        "pip install 'rerun-sdk>=0.41,<0.42'"
    )
