"""The closing words of a run."""

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from wayside.pipeline.cli.summary import print_summary, sign_table
from wayside.pipeline.reading.frames import ReadReport
from wayside.pipeline.results.inventory import WrittenTables
from wayside.pipeline.running.run import RunResult
from wayside.stages.georeference import DrivePath


def said_of(rows=(), *, notes=(), width=120, recorded=None, folder="out", **how):
    """What is printed at the end of a run of three images with these rows of signs.parquet."""
    path = DrivePath("enu", {}, {}, {}, np.zeros(0), None, None, {}, notes)
    inventory = WrittenTables("a", (), path, {"signs.parquet": 0}, {})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WrittenTables, "sign_rows", list(rows))
        report = ReadReport(notes=["header times are of different clocks"][: len(notes)])
        one = RunResult(
            Path("a.mcap"), Path(folder), inventory, report, {"used": 3}, {}, 1.0, recorded=recorded
        )
        stream = io.StringIO()
        print_summary(one, Console(file=stream, width=width, soft_wrap=True), **how)
    return stream.getvalue()


def test_what_is_amiss_with_the_log_is_said_at_the_end():
    late = "the fixes are 0.200 s behind the images (± 0.015 s), or their antenna 4.0 m behind the camera: corrected"
    lines = said_of(notes=(late,), width=200, kept=False).splitlines()
    assert "note: header times are of different clocks" in lines
    assert f"note: {late}" in lines
    assert "note:" not in said_of()


def row(**change):
    numbers = ("station_m", "lateral_m", "up_m", "panel_width_m", "panel_height_m", "sigma_along_m")
    told = {"sign_id": "rosbag2_2026_03_14-0017", "status": "uncertain", "shape": "rectangle"}
    told |= {"color": "fluorescent_yellow_green", "views": 23, "confidence": 0.4}
    return told | dict.fromkeys(numbers, -1234.56) | change


def test_the_table_of_signs_fits_into_80_columns_and_keeps_numbers_and_names_whole():
    stream = io.StringIO()
    console = Console(file=stream, width=80)
    demo = row(sign_id="demo-0017", color="red", status="sign", shape="octagon")
    console.print(sign_table([demo], console.width))
    assert len(stream.getvalue().splitlines()) == 2
    console.print(sign_table([row(), row()], console.width))
    said = stream.getvalue()
    assert max(map(len, said.splitlines())) <= 80
    assert said.count("-1234.56") == 9
    assert said.count("(uncertain)") == 2
    assert "…" not in said
    wide = io.StringIO()
    Console(file=wide, width=160).print(sign_table([row()], 160))
    assert "fluorescent yellow green" in wide.getvalue()


def test_shares_of_stages_and_verdicts_of_regions_are_for_who_asks():
    for verbose in (False, True):
        said = said_of(verbose=verbose)
        assert "3 images read: 3 used" in said
        assert ("processor time" in said) == ("no regions" in said) == verbose


def test_the_table_of_signs_says_what_sign_it_is_and_where_along_the_route():
    speed = row(mutcd="R2-1", legend="45", measure=12.3456, measure_unit="mi", status="sign")
    said = said_of([speed, row(measure=None, measure_unit=None)])
    assert "R2-1 45" in said
    assert "measure mi" in said
    assert "12.346" in said
    assert "station m" not in said
    assert "station m" in said_of([row()])


def test_a_run_ends_with_what_may_be_typed_next():
    said = said_of([row()], recorded=True, folder="my out").splitlines()[-1]
    assert said.startswith("next: wayside view 'my out' (every step); wayside evidence 'my out' (")
    assert "wayside export 'my out' -f csv" in said
    assert "wayside view" not in said_of([row()])
    assert "next:" not in said_of([])
