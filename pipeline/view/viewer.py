"""The Rerun viewer as a program of ours: found, started on loopback, asked for a screenshot, ended."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import numpy as np
import rerun as rr
from rerun.experimental import ViewerClient

from wayside.pipeline.view.entities import APPLICATION, FRAME
from wayside.schemas.errors import InputError, OutputError, UsageError

LOOPBACK = "127.0.0.1"
"""The viewer's own default listens to the whole network."""
PROBE_S, START_S, LOAD_S, DRAW_S = 0.5, 20.0, 60.0, 1.0
STEADY_POLLS, POLL_S = 3, 0.3
ATTEMPTS = 8
T = TypeVar("T")
VULKAN_DRIVERS = Path("/usr/share/vulkan/icd.d")
SOFTWARE = ("lvp_icd.x86_64.json", "lvp_icd.aarch64.json", "lvp_icd.json")
SILENT = {"CI": "1"}
"""The viewer sends usage statistics from its second start on, except where it believes to be tested."""
MEMORY = ("--memory-limit", "4GB", "--server-memory-limit", "1GiB")


def viewer_program() -> Path:
    """The viewer's own binary. The console script next to it is a wrapper that survives its child."""
    name = "rerun.exe" if os.name == "nt" else "rerun"
    path = Path(rr.__file__).resolve().parents[1] / "rerun_cli" / name
    if not path.is_file():
        raise InputError(f"{path}: the viewer of rerun-sdk is missing. Install rerun-sdk again.")
    return path


def probe(address: str) -> str:
    """The address of a viewer as Rerun writes it.

    Raises UsageError for what is no address, InputError where nobody listens: Rerun would wait, and then stop the run.
    """
    full = address if "://" in address else f"rerun+http://{address}/proxy"
    try:
        parts = urlsplit(full)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host is None or port is None:
        raise UsageError(
            f"--connect {address}: this is not an address. Write it as in rerun+http://127.0.0.1:9876/proxy or "
            "127.0.0.1:9876."
        )
    try:
        socket.create_connection((host, port), PROBE_S).close()
    except OSError as error:
        raise InputError(
            f"--connect {address}: no viewer listens there: {error}. Start one with `{viewer_program().name} --bind "
            f"{LOOPBACK} --port {port}`, or use --view file."
        ) from error
    return full


def start_viewer(
    files: Sequence[Path] = (),
    recording_id: str = "",
    *,
    serve: bool = False,
    web_port: int | None = None,
) -> str:
    """Start a viewer with a window, or with `serve` one for the browser; its address.

    It listens on loopback only and continues when this program ends. Its address, and how to end it, are printed on
    stderr. `files`: shown in this order, as parts of the recording of this id. Without files, the run sends the data.
    `web_port`: of the page, None: a free one. Raises InputError if there is no display, UsageError if the port is in
    use, OutputError if the viewer does not come up.
    """
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not serve and sys.platform == "linux" and not display:
        raise InputError(
            "the viewer's window needs a display, and DISPLAY is not set. Use --serve for a browser, `wayside "
            "picture` for a PNG, or copy the .rrd to a desktop."
        )
    port, web = _free_ports(0, web_port or 0)
    options = ["--serve-web", "--web-viewer-port", str(web)] if serve else []
    process = _start(port, options, {})
    address = f"rerun+http://{LOOPBACK}:{port}/proxy"
    # the server of the page starts after that of the data
    _wait_for_ports(process, (port, web) if serve else (port,))
    _send(files, recording_id, address)
    page = f"in a browser: http://{LOOPBACK}:{web}/?url={address}"
    print(
        f"{page if serve else 'the viewer is open'}; to close it: kill {process.pid}",
        file=sys.stderr,
    )
    return address


@contextlib.contextmanager
def headless(
    files: Sequence[Path], recording_id: str, size: tuple[int, int]
) -> Iterator[ViewerClient]:
    """A viewer without a window, drawn by a software Vulkan, with the files loaded.

    Raises OutputError if no software Vulkan is installed, or the viewer does not come up.
    """
    (port,) = _free_ports(0)
    options = ["--headless", "--window-size", f"{size[0]}x{size[1]}"]
    vulkan = {"WGPU_BACKEND": "vulkan", "VK_ICD_FILENAMES": str(software_vulkan())}
    process = _start(port, options, vulkan)
    try:
        _wait_for_ports(process, (port,))
        address = f"rerun+http://{LOOPBACK}:{port}/proxy"
        _send(files, recording_id, address)
        client = ViewerClient.connect(address)
        wait_until_loaded(client)
        yield client
    finally:
        _end(process)


def software_vulkan() -> Path:
    """The driver file of Mesa's software Vulkan; raises OutputError if it is missing."""
    for name in SOFTWARE:
        if (VULKAN_DRIVERS / name).is_file():
            return VULKAN_DRIVERS / name
    raise OutputError(
        f"there is no software Vulkan to draw with in {VULKAN_DRIVERS}. Install the Debian packages "
        "mesa-vulkan-drivers and libvulkan1, or use `wayside evidence`, which needs neither."
    )


def show_time(client: ViewerClient, timeline: str, value: int) -> None:
    """Move the time panel to a frame, or to nanoseconds on a timeline of times, and wait until the views have followed.

    A recording that is still loading moves the time on by itself, so it is set until it stays.
    """
    on_frames = timeline == FRAME
    place: Any = {"sequence": value} if on_frames else {"timestamp": np.datetime64(value, "ns")}

    def shown() -> bool:
        recordings = ask(client.get_state).recordings
        there = any(r.current_timeline == timeline and r.current_time == value for r in recordings)
        if not there:
            ask(lambda: client.set_time(timeline, **place))
        return there

    _wait_until_steady(shown)
    time.sleep(DRAW_S)


def wait_until_loaded(client: ViewerClient) -> None:
    """Return when the loaded recordings have stopped growing."""
    before = ""

    def loaded() -> bool:
        nonlocal before
        state = ask(client.get_state)
        now = str([(r.store_id, r.timelines) for r in state.recordings])
        same, before = now == before, now
        return same and bool(state.recordings) and bool(state.views)

    _wait_until_steady(loaded)


def _wait_until_steady(reached: Callable[[], bool]) -> None:
    late, steady = time.monotonic() + LOAD_S, 0
    while time.monotonic() < late and steady < STEADY_POLLS:
        steady = steady + 1 if reached() else 0
        time.sleep(POLL_S)


def ask(question: Callable[[], T]) -> T:
    """The answer of a viewer; raises OutputError if several attempts had no answer.

    It gives up after fifteen seconds. On a busy machine without a graphics card, the first image takes this long:
    programs are compiled for it, and nothing else is answered. Later ones are quick.
    """
    for _ in range(ATTEMPTS):
        with contextlib.suppress(TimeoutError):
            return question()
    raise OutputError(
        f"the viewer did not answer in {ATTEMPTS} attempts of fifteen seconds. Try again when the machine has less to "
        "do, or give a smaller --size."
    )


def import_log(log: Path, recording_id: str, target: Path) -> None:
    """Let Rerun convert a log to a recording of the given id, so that it joins that of a run.

    Raises InputError if Rerun cannot convert it.
    """
    command = [str(viewer_program()), "mcap", "convert", str(log), "-o", str(target)]
    command += ["--application-id", APPLICATION, "--recording-id", recording_id]
    environment = os.environ | SILENT | {"NO_COLOR": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    faults = [line for line in done.stderr.splitlines() if "ERROR" in line]  # with exit status 0
    if done.returncode != 0 or faults or not target.is_file():
        target.unlink(missing_ok=True)
        found = (faults or done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise InputError(f"{log}: Rerun cannot import the log: {found}")


def _free_ports(*wanted: int) -> list[int]:
    """Different ports of loopback that nobody listens at, any for 0; raises UsageError for one that is in use."""
    with contextlib.ExitStack() as held:
        try:
            sockets = [held.enter_context(socket.create_server((LOOPBACK, one))) for one in wanted]
        except OSError as error:
            raise UsageError(f"--port: {error.strerror}. Choose another port.") from error
        return [int(one.getsockname()[1]) for one in sockets]


def _start(port: int, options: Sequence[str], more: dict[str, str]) -> subprocess.Popen[bytes]:
    command = [str(viewer_program()), "--bind", LOOPBACK, "--port", str(port), *MEMORY, *options]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = os.environ | SILENT | more
    return subprocess.Popen(command, env=environment, start_new_session=True, **quiet)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the viewer and all it started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if os.name == "nt":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _send(files: Sequence[Path], recording_id: str, address: str) -> None:
    """Send files to a viewer, one after the other.

    A viewer that is given several files reads them at the same time, and shows the layout of the last one. This can be
    the requested layout or the one inside the recording.
    """
    for file in files:
        stream = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        stream.connect_grpc(address)
        stream.log_file_from_path(str(file))
        stream.flush()
        stream.disconnect()


def _wait_for_ports(process: subprocess.Popen[bytes], ports: Sequence[int]) -> None:
    late, closed = time.monotonic() + START_S, list(ports)
    while time.monotonic() < late and process.poll() is None:
        try:
            socket.create_connection((LOOPBACK, closed[0]), 0.2).close()
            closed.pop(0)
        except OSError:
            time.sleep(0.1)
        if not closed:
            return
    _end(process)
    raise OutputError(
        f"the viewer did not start within {START_S:g} s: "
        f"{'no answer' if process.returncode is None else 'it ended at once'}. Try `{viewer_program()} --version`."
    )
