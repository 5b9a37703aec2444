"""Every intermediate result in the Rerun viewer: its appearance, its destination and its layout.

Nothing else needs Rerun, which is large. Tables are made without it, and the viewer commands report that it is missing.
"""

from importlib.util import find_spec

from wayside.schemas.errors import UsageError

if find_spec("rerun") is None:
    raise UsageError(
        "recording, viewing and drawing the steps of a run need Rerun, which is not installed. Install it with pip "
        "install 'rerun-sdk>=0.41,<0.42'."
    )
