"""What the tests of the pipeline share: pages in a real browser without a window, and Exif data as cameras write it."""

import json
import re
import shutil
import subprocess
from html import unescape

import pytest
from PIL import Image

from wayside.pipeline.reading.calibrations import format_camera
from wayside.schemas.frame import Camera

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
_FOUND = next((path for path in map(shutil.which, NAMES) if path), None)
_HARNESS = """<script>
addEventListener("pageshow", async () => {
  const report = document.createElement("pre");
  report.id = "wayside-test";
  const press = (key, target = document.body) =>
    target.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  // The dump of the page waits for timers, but not for the decoding of an image.
  const until = async (done) => { while (!done()) await new Promise((go) => setTimeout(go, 10)); };
  try { report.textContent = "DONE" + JSON.stringify(await (async () => { %s })()); }
  catch (error) { report.textContent = "FAIL" + error.stack; }
  document.body.append(report);
}, { once: true });
</script></body>"""


@pytest.fixture(scope="session")
def in_browser():
    """`_run_page`, where there is a browser."""
    if _FOUND is None:
        pytest.skip("no Chromium on this machine")
    return _run_page


def _run_page(page, script, fragment="", profile=None, width=1280):
    """What a script (the body of an async function with `press` and `until`) returns in a copy of a page.

    profile: folder of a browser profile, kept between calls; None: a new one. width: of the window, pixels.
    """
    copy = page.with_name(f"{page.stem}.tested.html")
    copy.write_text(page.read_text("utf-8").replace("</body>", _HARNESS % script), "utf-8")
    command = [str(_FOUND), "--headless", "--no-sandbox", "--disable-dev-shm-usage"]
    command += ["--disable-gpu", "--dump-dom", "--virtual-time-budget=20000"]
    command += [f"--window-size={width},844", copy.as_uri() + fragment]
    command += [f"--user-data-dir={profile}"] if profile else []
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    found = re.search(r'<pre id="wayside-test">(DONE|FAIL)(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-2000:]
    assert found[1] == "DONE", unescape(found[2])
    return json.loads(unescape(found[2]))


@pytest.fixture
def calibration(tmp_path):
    """A file of the lens of images of 32 x 24 pixels."""
    path = tmp_path / "camera.yaml"
    camera = Camera(32, 24, 50.0, 51.0, 16.0, 12.0, (-0.2, 0.1, 0.0, 0.0, 0.5))
    path.write_text(format_camera(camera, "camera"))
    return path


def with_exif(jpeg, *, orientation=None, taken="", fraction="", offset="", changed=""):
    """A JPEG with an Exif segment before its others; the pixels stay as they are."""
    exif = Image.Exif()
    if orientation is not None:
        exif[0x0112] = orientation
    if changed:
        exif[0x0132] = changed
    for tag, value in ((0x9003, taken), (0x9291, fraction), (0x9011, offset)):
        if value:
            exif.get_ifd(0x8769)[tag] = value
    segment = exif.tobytes()
    return jpeg[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment + jpeg[2:]
