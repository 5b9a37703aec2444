"""The closing words of a run."""

import dataclasses
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
    one = result(())
    for verbose in (False, True):
        stream = io.StringIO()
        print_summary(one, Console(file=stream, width=80), verbose=verbose)
        said = stream.getvalue()
        assert "3 images read: 3 used" in said
        assert ("processor time" in said) == ("no regions" in said) == verbose


@pytest.fixture
def said_of(monkeypatch):
    """What is printed of rows of signs.parquet."""

    def words(rows, recorded=None, folder="out"):
        monkeypatch.setattr(WrittenTables, "sign_rows", rows)
        one = dataclasses.replace(result(()), folder=Path(folder), recorded=recorded)
        stream = io.StringIO()
        print_summary(one, Console(file=stream, width=120, soft_wrap=True))
        return stream.getvalue()

    return words


def test_the_table_of_signs_says_what_sign_it_is_and_where_along_the_route(said_of):
    speed = row(mutcd="R2-1", legend="45", measure=12.3456, measure_unit="mi", status="sign")
    said = said_of([speed, row(measure=None, measure_unit=None)])
    assert "R2-1 45" in said
    assert "measure mi" in said
    assert "12.346" in said
    assert "station m" not in said
    assert "station m" in said_of([row()])


def test_a_run_ends_with_what_may_be_typed_next(said_of):
    said = said_of([row()], recorded=True, folder="my out").splitlines()[-1]
    assert said.startswith("next: wayside view 'my out' (every step); wayside evidence 'my out' (")
    assert "wayside export 'my out' -f csv" in said
    assert "wayside view" not in said_of([row()])
    assert "next:" not in said_of([])
