"""Texts of strangers in CSV."""

import csv
import io

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.csv_text import guarded, unguarded
from wayside.pipeline.exporting.flat_table import Chunk, FlatTable
from wayside.pipeline.exporting.text_files import write_csv
from wayside.schemas.tables import Column


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@x", "\t=1", "\r=1"])
def test_a_text_that_a_spreadsheet_would_evaluate_gets_an_apostrophe(text):
    assert guarded(text) == f"'{text}"


@given(st.text(alphabet="'=+-@\t\rab "))
def test_the_apostrophe_is_taken_off_again(text):
    assert unguarded(guarded(text)) == text


def test_an_exported_number_stays_as_it_is_beside_a_text_that_would_be_a_formula():
    columns = tuple(Column(name, pa.string(), "", "") for name in ("log", "y"))
    rows = FlatTable(columns, ({"log": '=cmd|"x"', "y": -1.5},))
    written = io.BytesIO()
    write_csv(columns, [Chunk(rows, (None,))], written)
    assert list(csv.reader(io.StringIO(written.getvalue().decode())))[1] == ['\'=cmd|"x"', "-1.5"]
