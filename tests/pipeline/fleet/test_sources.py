"""Which logs are meant by what somebody types, and how they are read."""

import pytest

from wayside.pipeline.fleet.manifest import free_name
from wayside.pipeline.fleet.sources import (
    UnreachableError,
    expand_sources,
    fetched,
    fingerprint_source,
    source_name,
)
from wayside.pipeline.results.result import log_fingerprint
from wayside.schemas.errors import UsageError


@pytest.fixture
def archive(tmp_path, monkeypatch):
    for name in ("2024/a.mcap", "2026/a.mcap", "2026/deep/b.MCAP", "2026/notes.txt", "c.mcap"):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_folders_patterns_and_lists_give_each_log_once_in_order(archive):
    (archive / "list.txt").write_text("# both\n2026\n\nc.mcap\n")
    given = expand_sources(["c.mcap", "2024/../*/a.mcap", "@list.txt"])
    assert given[:1] == [str(archive / "c.mcap")]
    assert expand_sources(["*/a.mcap"]) == [str(archive / n / "a.mcap") for n in ("2024", "2026")]
    listed = [str(archive / name) for name in ("2026/a.mcap", "2026/deep/b.MCAP", "c.mcap")]
    assert expand_sources(["@list.txt", "2026"]) == listed
    assert len(given) == len(set(given)) == 5


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_lists_are_read_as_editors_and_file_managers_write_them(archive, encoding):
    (archive / "Bögen.mcap").touch()
    lines = ['"2026"', "", "  'c.mcap' ", "Bögen.mcap"]
    (archive / "list.txt").write_bytes("\r\n".join(lines).encode(encoding))
    listed = ("2026/a.mcap", "2026/deep/b.MCAP", "c.mcap", "Bögen.mcap")
    assert expand_sources(["@list.txt"]) == [str(archive / name) for name in listed]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("2026/*.bag", "no logs"),
        ("empty", "no logs"),
        ("@none.txt", "cannot be read"),
        ("@nested.txt", "another list, @list.txt"),
    ],
)
def test_what_gives_no_log_is_told(archive, text, words):
    (archive / "empty").mkdir()
    (archive / "nested.txt").write_text("@list.txt")
    with pytest.raises(UsageError, match=words):
        expand_sources([text])


def test_a_storage_is_listed_fingerprinted_and_loaded_as_files_are(archive):
    pytest.importorskip("fsspec")
    url = archive.as_uri()
    found = expand_sources([f"{url}/2026", f"{url}/*.mcap"])
    assert found == [f"{url}/2026/a.mcap", f"{url}/2026/deep/b.MCAP", f"{url}/c.mcap"]
    assert fingerprint_source(found[0]) == fingerprint_source(str(archive / "2026" / "a.mcap"))
    with fetched(found[1]) as log:
        assert log.stem == "b"
        assert log_fingerprint(log) == fingerprint_source(found[1])[0]
    assert not log.exists()


def test_what_cannot_be_read_is_told(archive):
    pytest.importorskip("fsspec")
    for uri in (str(archive), "none.mcap", f"{archive.as_uri()}/none.mcap"):
        with pytest.raises(UnreachableError, match=r"not a log|no such log|the log cannot be read"):
            fingerprint_source(uri)
    with pytest.raises(UsageError, match="fsspec does not know"):
        expand_sources(["nothing://bucket/a.mcap"])


def test_logs_of_one_name_are_told_apart_by_their_folders():
    assert source_name("s3://bucket/2026/a%20b.mcap?versionId=1") == ("a b", "2026")
    assert free_name("/x/2026/A.mcap", ()) == "A"
    assert free_name("/x/2026/A.mcap", {"a"}) == "2026_A"
    assert free_name("/x/2026/A.mcap", {"a", "2026_a"}) == "A_2"
    assert free_name("/x/2026/.hidden.mcap", ()) == "hidden"
    for ordinary in ("drive", "2026-05-01T10:00:00", "a b (1)[2]", "fahrt_müller", "x" * 250):
        assert free_name(f"/x/{ordinary}.mcap", ()) == ordinary


@pytest.mark.parametrize(
    "stem",
    ["x" * 252, "é" * 130, "a\\..\\b", "a\nb", "\udcff", "..", "a*b?", "...", "\U0001f6d1" * 70],
)
def test_names_of_folders_are_short_plain_and_different(stem, tmp_path):
    names = [free_name(f"/{parent}/{stem}", ()) for parent in ("a", "b")]
    names.append(free_name(f"/{'p' * 200}/{stem}", {names[0].casefold()}))
    names.append(free_name(f"/a/{stem}y", {name.casefold() for name in names}))
    assert names[0] == names[1]
    assert len(set(names)) == 3
    for name in set(names):
        (tmp_path / f"{name}.mcap").mkdir()
        assert not set(name) & set("/\\\n*?")
        assert not name.startswith(".")
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.mcap" for name in set(names)}
