"""The viewer as a program: absent, headless, and what the commands say."""

import os
import re
import signal
import socket
import threading
import time
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import cv2
import pyarrow.parquet as pq
import pytest
import rerun as rr

from wayside.pipeline.cli.running import parse_rate
from wayside.pipeline.view import viewer
from wayside.pipeline.view.blueprint import drive_layout, sign_layout
from wayside.pipeline.view.results import find_target, recordings_of
from wayside.pipeline.view.viewer import import_log, probe, software_vulkan, start_viewer
from wayside.schemas.errors import InputError, OutputError, UsageError

from ..results import invoke

DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"


def test_an_absent_viewer_is_an_error_and_one_that_listens_has_its_full_address():
    with socket.create_server(("127.0.0.1", 0)) as one:
        port = one.getsockname()[1]
        full = f"rerun+http://127.0.0.1:{port}/proxy"
        assert probe(f"127.0.0.1:{port}") == full
        assert probe(full) == full
    with pytest.raises(InputError, match="no viewer listens there"):
        probe(f"127.0.0.1:{port}")  # Rerun alone would wait for ever


@pytest.mark.parametrize("address", ["nowhere", "rerun+http://host/proxy", "127.0.0.1:port"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(UsageError, match="not an address"):
        probe(address)


def test_without_a_display_other_ways_are_named(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match="wayside picture"):
        start_viewer()


def test_without_a_software_vulkan_the_packages_are_named(monkeypatch, tmp_path):
    monkeypatch.setattr(viewer, "VULKAN_DRIVERS", tmp_path)
    with pytest.raises(OutputError, match="mesa-vulkan-drivers"):
        software_vulkan()


def test_rates_are_times_the_recorded_speed():
    texts = {"1x": 1.0, "0.5x": 0.5, "4": 4.0, "max": None}
    assert {text: parse_rate(text) for text in texts} == texts
    for text in ("0x", "fast", "-1x", "nan", ""):
        with pytest.raises(UsageError, match="--rate"):
            parse_rate(text)


def test_layouts_are_written_as_files(tmp_path):
    of_sign = sign_layout("demo-0001", 30.0, (10.0, 10.0, 40.0, 30.0))
    for name, layout in (("drive", drive_layout()), ("sign", of_sign)):
        layout.save("wayside", str(tmp_path / name))
        reader = rr.chunk.RrdReader(str(tmp_path / name))
        chunks = reader.stream(store=reader.blueprints()[0])
        stated = {one for chunk in chunks for one in chunk.to_record_batch().schema.names}
        assert {"Background:color", "PlotLegend:visible"} <= stated
        assert ("TextLogColumns:text_log_columns" in stated) == (name == "drive")


def has_vulkan():
    try:
        software_vulkan()
    except OutputError:
        return False
    return True


def recorded(folder, *options):
    invoke("run", DEMO, "-o", folder, "--view", "file", "--until", "0.7s", *options)
    return folder


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("drawn"))


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("bare"), "--view-images", "none")


@pytest.mark.skipif(not has_vulkan(), reason="no software Vulkan: install mesa-vulkan-drivers")
@pytest.mark.parametrize(
    ("asked", "over"), [(["--frame", "2"], False), (["--sign", "demo-0001"], True)]
)
def test_the_headless_viewer_draws_a_run_and_no_view_reports_an_error(
    command, result, bare, tmp_path, asked, over
):
    result, asked = (bare, [*asked, "--over", str(DEMO)]) if over else (result, asked)
    png = tmp_path / "drawn.png"
    done = command("picture", result, "-o", png, "--size", "900x600", *asked)
    assert done.returncode == 0, done.stderr
    drawn = cv2.imread(str(png))
    assert drawn.shape[0] >= 600
    assert drawn.std() > 20


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (["--sign", "demo-9999"], "Did you mean demo-"),
        (["--frame", "999"], "does not hold this frame, but 0 to"),
        (["--frame", "1", "--sign", "demo-0001"], "both given"),
        (["--over", str(DEMO)], "holds images of its own"),
        (["--port", "BUSY"], "Choose another port"),
        (["--no-serve", "--port", "8080"], "Add --serve"),
    ],
)
def test_a_sign_frame_or_port_that_is_not_there_is_named(command, result, asked, words):
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = str(busy.getsockname()[1])
        asked = [port if one == "BUSY" else one for one in asked]
        serve = [] if "--no-serve" in asked else ["--serve"]
        done = command("view", result, *serve, *(one for one in asked if one != "--no-serve"))
    assert done.returncode == 2
    assert words in done.stderr


def test_an_address_is_told_once_both_its_servers_answer(monkeypatch):
    servers, fake = [], SimpleNamespace(pid=0, poll=lambda: None)

    def late(port):
        time.sleep(0.3)
        servers.append(socket.create_server(("127.0.0.1", port)))

    def start(port, options, environment):
        servers.append(socket.create_server(("127.0.0.1", port)))
        threading.Thread(target=late, args=(int(options[-1]),)).start()
        return fake

    monkeypatch.setattr(viewer, "_start", start)
    start_viewer(serve=True)
    assert len(servers) == 2
    for server in servers:
        server.close()


def test_a_viewer_that_is_still_compiling_is_asked_again():
    answers = iter([TimeoutError, TimeoutError, "drawn"])

    def busy():
        answer = next(answers, TimeoutError)
        if answer is TimeoutError:
            raise TimeoutError
        return answer

    assert viewer.ask(busy) == "drawn"
    with pytest.raises(OutputError, match="the viewer did not answer"):
        viewer.ask(busy)


@pytest.mark.skipif(not has_vulkan(), reason="no software Vulkan: install mesa-vulkan-drivers")
def test_the_layout_that_is_asked_for_is_shown_instead_of_that_of_the_recording(result, tmp_path):
    found, target = recordings_of(result, None), find_target(result, "demo-0001", None)
    with viewer.headless(found.files(target, tmp_path), found.recording_id, (400, 300)) as client:
        names = {view.name for view in client.get_state().views}
        assert [r.store_id for r in client.get_state().recordings] == ["Recording:wayside:demo"]
    assert any(name.startswith("demo-0001: box") for name in names)


def test_without_a_frame_the_one_that_shows_most_signs_is_opened(result):
    signs = pq.read_table(result / "signs.parquet").to_pylist()

    def shown(frame):
        return sum(s["first_frame"] <= frame <= s["last_frame"] for s in signs)

    opened = find_target(result, None, None).frame
    assert shown(opened) == max(map(shown, range(4))) > 0
    assert all(shown(before) < shown(opened) for before in range(opened))


def test_what_rerun_cannot_import_is_refused(tmp_path):
    (tmp_path / "log.mcap").write_bytes(b"no log")
    with pytest.raises(InputError, match="Rerun cannot import the log"):
        import_log(tmp_path / "log.mcap", "demo", tmp_path / "log.rrd")


def test_a_result_is_served_to_browsers_on_loopback(python, result):
    (port,) = viewer._free_ports(0)
    asked = ["view", result, "--serve", "--port", port, "--sign", "demo-0001"]
    done = python("from wayside.pipeline.cli import main; main()", *asked)
    address, pid = re.search(
        rf"(http://127\.0\.0\.1:{port}/)\S*; to close it: kill (\d+)", done.stderr
    ).groups()
    try:
        with urllib.request.urlopen(address, timeout=10) as answer:
            assert b"rerun" in answer.read().lower()
    finally:
        os.kill(int(pid), signal.SIGKILL)
