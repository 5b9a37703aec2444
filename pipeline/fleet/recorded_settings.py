"""What a table of an inventory was made with: settings in the metadata of its files."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from wayside.schemas.settings import ChangeSettings, MergeSettings
from wayside.schemas.tables import Table

_KEY = b"wayside"


def schema_with_settings(table: Table, **groups: MergeSettings | ChangeSettings) -> pa.Schema:
    """The schema of a table with groups of settings, by name, in its metadata under the key `wayside`."""
    about = json.loads((table.schema.metadata or {})[_KEY])
    about["settings"] = {name: asdict(group) for name, group in groups.items()}
    return table.schema.with_metadata({_KEY: json.dumps(about).encode()})


def merge_settings_of(part: Path) -> MergeSettings:
    """The settings that a part of an inventory was merged with; defaults where an earlier version did not say.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    about = json.loads((pq.read_schema(part).metadata or {}).get(_KEY, b"{}"))
    said = about.get("settings", {}).get("merge", {})
    known = {each.name for each in fields(MergeSettings)}
    return MergeSettings(**{name: value for name, value in said.items() if name in known})
