"""Files that are read whole: a command refuses those that it would wait for, and those that unpack without a limit."""

import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wayside.pipeline.files import input_files, parquet
from wayside.pipeline.files.input_files import files_below, open_input, read_input, read_input_text
from wayside.pipeline.files.parquet import read_parquet


def test_pipes_devices_and_files_beyond_the_bound_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="a pipe, not a file"):
        open_input(tmp_path / "pipe")
    with pytest.raises(OSError, match="a device, not a file"):
        read_input(type(tmp_path)("/dev/zero"))
    with (tmp_path / "sparse").open("wb") as stream:
        stream.truncate(input_files.MOST_BYTES + 1)
    with pytest.raises(OSError, match="more than"):
        read_input(tmp_path / "sparse")


def test_a_table_is_that_of_pyarrow(tmp_path):
    texts = pa.array(["a", None, "b", "a"])
    table = pa.table({"n": [1, 2, 3, 4], "t": texts, "d": texts.dictionary_encode()})
    pq.write_table(table, tmp_path / "t.parquet")
    assert read_parquet(tmp_path / "t.parquet").equals(pq.read_table(tmp_path / "t.parquet"))
    some = read_parquet(tmp_path / "t.parquet", ["t"], {"n": [3]})
    assert read_parquet(tmp_path / "t.parquet", ["n"], {"t": "a", "d": "a"}).num_rows == 2
    assert some.to_pydict() == {"t": ["b"]}
    with pytest.raises(pa.ArrowInvalid, match="no column y; its columns are n, t, d"):
        read_parquet(tmp_path / "t.parquet", ["y"])


@pytest.mark.parametrize(
    "column",
    [
        pa.array(np.zeros(200_000, np.int64)),
        pa.array(["x" * 5000] * 1000),
        pa.array([b"x" * 5000] * 1000, pa.binary(5000)),
    ],
    ids=["rows", "texts", "fixed width"],
)
def test_parquet_that_unpacks_beyond_the_bound_is_refused(tmp_path, monkeypatch, column):
    path = tmp_path / "bomb.parquet"
    pq.write_table(pa.table({"frame": column}), path, compression="zstd")
    monkeypatch.setattr(parquet, "MOST_BYTES", 1_000_000)
    assert path.stat().st_size < 20_000
    with pytest.raises(pa.ArrowInvalid, match="unpacks to"):
        read_parquet(path)


def test_a_table_is_read_without_threads_of_arrow(python, tmp_path):
    """They abort a short command at its end now and then; tables with and without filters, in a fresh process."""
    file = tmp_path / "signs.parquet"
    table = pa.table({"status": ["sign", "back"] * 500, "x": range(1000)})
    pq.write_table(table, file, row_group_size=300)
    code = (
        "import os, sys; from pathlib import Path\n"
        "from wayside.pipeline.files.parquet import read_parquet\n"
        "before = len(os.listdir('/proc/self/task'))\n"
        "rows = read_parquet(Path(sys.argv[1]), ['x', 'status'], {'status': 'sign'}).num_rows\n"
        "print(rows, read_parquet(Path(sys.argv[1])).num_rows, len(os.listdir('/proc/self/task')) - before)"
    )
    assert python(code, file).stdout.split() == ["500", "1000", "0"]


READ_ALL = """
import sys
from pathlib import Path
import pyarrow as pa
from wayside.pipeline.files.parquet import read_parquet

path = Path(sys.argv[1])
content = path.read_bytes()
for at in range(len(content) - 8 - int.from_bytes(content[-8:-4], "little"), len(content)):
    for value in (0x15, 0xFF):
        path.write_bytes(content[:at] + bytes([value]) + content[at + 1 :])
        try:
            read_parquet(path)
        except (OSError, pa.ArrowException):
            pass
"""


def test_a_changed_footer_of_parquet_is_refused_and_does_not_end_the_process(python, tmp_path):
    path = tmp_path / "t.parquet"
    pq.write_table(pa.table({"text": ["a", None], "list": [[1], None]}), path)
    assert not python(READ_ALL, path).stderr


def test_text_is_read_in_the_encodings_that_programs_write_and_other_bytes_are_refused(tmp_path):
    file = tmp_path / "list.txt"
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "cp1252"):
        file.write_bytes("Bögen ±1\n".encode(encoding))
        assert read_input_text(file) == "Bögen ±1\n"
    for data in (b"a\0b", b"\x81\xff", b"\xff\xfe\x00"):
        file.write_bytes(data)
        with pytest.raises(ValueError, match=r"not text|decode"):
            read_input_text(file)


def test_a_folder_that_cannot_be_listed_is_not_passed_over(tmp_path, monkeypatch):
    (tmp_path / "closed").mkdir()
    (tmp_path / "a.txt").touch()
    assert list(files_below(tmp_path)) == [tmp_path / "a.txt"]
    listed = os.scandir

    def scandir(path):
        if str(path).endswith("closed"):
            raise PermissionError(13, "Permission denied", str(path))
        return listed(path)

    monkeypatch.setattr(os, "scandir", scandir)
    with pytest.raises(PermissionError, match="closed"):
        list(files_below(tmp_path))
