"""The closing words of a run."""

import io
from pathlib import Path

import numpy as np
from rich.console import Console

from wayside.pipeline.inventory import WrittenTables
from wayside.pipeline.reading.frames import ReadReport
from wayside.pipeline.run import RunResult
from wayside.pipeline.summary import print_summary
from wayside.stages.georeference import DrivePath

LATE = "the fixes are 0.200 s behind the images (± 0.015 s), or their antenna 4.0 m behind the camera: corrected"


def result(notes):
    path = DrivePath("enu", {}, {}, {}, np.zeros(0), None, None, {}, notes)
    inventory = WrittenTables("a", (), path, {"signs.parquet": 0}, {})
    report = ReadReport(notes=["header times are of different clocks"])
    return RunResult(Path("a.mcap"), Path("out"), inventory, report, {"used": 3}, {}, 1.0)


def test_what_is_amiss_with_the_log_is_said_at_the_end():
    stream = io.StringIO()
    print_summary(result((LATE,)), Console(file=stream, width=200), kept=False)
    lines = stream.getvalue().splitlines()
    assert "note: header times are of different clocks" in lines
    assert f"note: {LATE}" in lines


def test_a_log_without_faults_has_no_notes():
    one = result(())
    one.report.notes.clear()
    assert one.notes == []
