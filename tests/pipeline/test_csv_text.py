"""Texts of strangers in CSV."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.files.parsing import guarded, read_csv, unguarded


@given(st.text(alphabet="'=+-@\t\rab "))
def test_a_text_that_a_spreadsheet_would_evaluate_gets_an_apostrophe_that_is_taken_off_again(text):
    assert not guarded(text).startswith(tuple("=+-@\t\r"))
    assert unguarded(guarded(text)) == text


ROWS = [{"sign_id": "d-1", "x": "12.5", "note": "3,5; say"}, {"sign_id": "d-2", "y": "-3.25"}]
AS_PROGRAMS_WRITE_IT = {
    "commas": 'sign_id,x,y,note\nd-1,12.5,,"3,5; say"\nd-2,,-3.25,\n',
    "semicolons and decimal commas": 'sign_id;x;y;note\r\nd-1;12,5;;"3,5; say"\r\nd-2;;-3,25;\r\n',
    "tabs": "sign_id\tx\ty\tnote\nd-1\t12,5\t\t3,5; say\nd-2\t\t-3,25\n",
    "empty rows": '\n;;;\n"sign_id";"x";"y";"note"\n;;;\nd-1;12.5;;"3,5; say"\n\nd-2;;-3.25;\n ; ; ; \n',
    "blanks": 'sign_id , x , y, note\nd-1 , 12.5,,"3,5; say"\nd-2 ,,-3.25, \n',
    "an apostrophe": "sign_id\tx\ty\tnote\nd-1\t12.5\t\t3,5; say\nd-2\t\t'-3.25\n",
    "the mark of Excel": 'sep=;\r\nsign_id;x;y;note\r\nd-1;12,5;;"3,5; say"\r\nd-2;;-3,25;\r\n',
}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("what", AS_PROGRAMS_WRITE_IT)
def test_tables_say_the_same_however_a_program_writes_them(tmp_path, what, encoding):
    (tmp_path / "t.csv").write_bytes(AS_PROGRAMS_WRITE_IT[what].encode(encoding))
    assert read_csv(tmp_path / "t.csv", "xy") == (["sign_id", "x", "y", "note"], ROWS)


def test_a_row_with_more_values_than_the_first_is_refused(tmp_path):
    (tmp_path / "t.csv").write_text("sign_id,note\nd-1,a bin, not a sign\n")
    with pytest.raises(ValueError, match="row 1 has 3 values"):
        read_csv(tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("\n")
    assert read_csv(tmp_path / "t.csv") == ([], [])
