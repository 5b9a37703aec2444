"""The accepted signs of many drives as one table of panels."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from wayside.pipeline.result import read_table
from wayside.pipeline.writing import not_written
from wayside.schemas.tables import SIGNS


@dataclass(frozen=True, slots=True)
class MergeReport:
    """What was merged."""

    drives: int
    panels: int

    def __str__(self) -> str:
        return f"{self.panels} panels of {self.drives} drives"


def merge_inventory(results: Sequence[Path], out: Path) -> MergeReport:
    """Write the accepted signs of results into `panels/` of an inventory.

    Raises
    ------
    InputError
        A folder holds no result.
    OutputError
        The inventory cannot be written.
    """
    tables = []
    for folder in results:
        signs = read_table(folder, SIGNS)
        drive: pa.StringArray = pa.array([folder.name] * len(signs), pa.string())
        accepted = signs.append_column("drive", drive)
        tables.append(
            accepted.filter(pc.equal(pc.cast(signs["status"], pa.string()), pa.scalar("sign")))
        )
    part, target = out / ".wayside-merge-part", out / "panels"
    try:
        shutil.rmtree(part, ignore_errors=True)
        folder = part / "cell=0"
        folder.mkdir(parents=True)
        merged = pa.concat_tables(tables).unify_dictionaries()
        pq.write_table(merged, folder / "part-0.parquet")
        shutil.rmtree(target, ignore_errors=True)
        part.rename(target)
    except OSError as error:
        raise not_written(out, error) from error
    return MergeReport(len(results), len(merged))
