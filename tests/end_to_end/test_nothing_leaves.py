"""No command sends anything: no network socket, no name look-up, none in native code either, no file at home."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from shutil import which

import pytest

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
WATCH_C = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <netdb.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

static void note(const char *what, const char *which) {
  int log = open(getenv("NETWORK_LOG"), O_WRONLY | O_APPEND | O_CREAT, 0600);
  write(log, what, strlen(what));
  write(log, which, strlen(which));
  write(log, "\n", 1);
  close(log);
}

int socket(int family, int type, int protocol) {
  int (*real)(int, int, int) = dlsym(RTLD_NEXT, "socket");
  if (family == AF_INET || family == AF_INET6) note("socket", "");
  return real(family, type, protocol);
}

int getaddrinfo(const char *name, const char *service, const struct addrinfo *hints,
                struct addrinfo **found) {
  int (*real)(const char *, const char *, const struct addrinfo *, struct addrinfo **) =
      dlsym(RTLD_NEXT, "getaddrinfo");
  note("look-up ", name ? name : "");
  return real(name, service, hints, found);
}

struct hostent *gethostbyname(const char *name) {
  struct hostent *(*real)(const char *) = dlsym(RTLD_NEXT, "gethostbyname");
  note("look-up ", name);
  return real(name);
}
"""
RUN = (
    "import sys, time; from wayside.pipeline.cli import main\ntry: main()\nfinally: time.sleep({})"
)
"""A command, and a while in which the threads of its libraries go on."""
VENDOR_WAITS_S = 14
"""onnxruntime looks its vendor up for the first time nine seconds after its first network."""


@pytest.fixture(scope="module")
def watch(tmp_path_factory):
    """Environment in which each network call leaves a line, and a function that tells them."""
    folder = tmp_path_factory.mktemp("watch")
    library, log = folder / "watch.so", folder / "calls"
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "ORT_", "CI"))}
    compiler = which("cc") if sys.platform == "linux" else None
    if compiler is not None:
        (folder / "watch.c").write_text(WATCH_C)
        command = [compiler, "-shared", "-fPIC", "-w", "-o", library, folder / "watch.c", "-ldl"]
        subprocess.run(command, check=True)
        environment |= {"LD_PRELOAD": str(library), "NETWORK_LOG": str(log)}

    def calls():
        if compiler is None:
            pytest.skip("no C compiler on Linux: calls of native code cannot be watched")
        text = log.read_text() if log.exists() else ""
        log.unlink(missing_ok=True)
        return text.splitlines()

    return environment, calls


def run(environment, home, *command, linger=0.0):
    home.mkdir()
    line = [sys.executable, "-c", RUN.format(linger), *map(str, command)]
    subprocess.run(line, check=True, env=environment | {"HOME": str(home)}, capture_output=True)


def test_the_watch_sees_sockets_and_look_ups(watch):
    environment, calls = watch
    code = "import socket; socket.getaddrinfo('localhost', 1); socket.socket(socket.AF_INET6)"
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    assert calls() == ["look-up localhost", "socket"]


@pytest.mark.parametrize(
    "linger", [0.0, pytest.param(VENDOR_WAITS_S, marks=pytest.mark.slow)], ids=["at once", "later"]
)
def test_a_run_sends_nothing_and_leaves_nothing_at_home(watch, tmp_path, linger):
    environment, calls = watch
    home, out = tmp_path / "home", tmp_path / "out"
    options = ("--until", "0.3", "--view", "file")
    run(environment, home, "run", DEMO, "-o", out, *options, linger=linger)
    assert (out / "drive.rrd").is_file()
    assert list(home.rglob("*")) == []
    assert calls() == []


@pytest.mark.slow
def test_processes_of_a_fleet_send_nothing(watch, tmp_path):
    environment, calls = watch
    (tmp_path / "archive").mkdir()
    (tmp_path / "archive" / "demo.mcap").symlink_to(DEMO)
    home, out = tmp_path / "home", tmp_path / "inventory"
    run(environment, home, "fleet", tmp_path / "archive", "-o", out, "--set", "read.until_s=0.5")
    assert list(home.rglob("*")) == []
    assert calls() == []


@pytest.mark.slow
def test_the_viewer_s_program_looks_nobody_up(watch, tmp_path):
    environment, calls = watch
    code = (
        "from pathlib import Path\nfrom wayside.pipeline.view.viewer import import_log, start_viewer\n"
        f"import_log(Path({str(DEMO)!r}), 'demo', Path('log.rrd')); start_viewer(serve=True)"
    )
    environment = environment | {"HOME": str(tmp_path / "home")}
    for _ in range(2):  # at its first start it sends nothing
        line = [sys.executable, "-c", code]
        done = subprocess.run(
            line, check=True, env=environment, capture_output=True, text=True, cwd=tmp_path
        )
        time.sleep(1)
        os.kill(int(re.findall(r"kill (\d+)", done.stderr)[0]), signal.SIGKILL)
    assert not (tmp_path / "home").exists()
    assert set(calls()) <= {"socket", "look-up 127.0.0.1"}


def test_telemetry_is_off_unless_the_user_has_set_it():
    code = "import os, wayside; print(os.environ['ORT_DISABLE_TELEMETRY'])"
    unset = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    for own, kept in (({}, "1"), ({"ORT_DISABLE_TELEMETRY": "0"}, "0")):
        line = [sys.executable, "-c", code]
        done = subprocess.run(line, env=unset | own, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == kept
