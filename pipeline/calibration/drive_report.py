"""A calibration by a drive in words, and what it says of the calibration that was given."""

from __future__ import annotations

import numpy as np

from wayside.pipeline.calibration.drives import CalibratedDrive
from wayside.stages.calibration import LENS, changed_camera

LARGEST_SIGMA = 0.03
"""A focal length with a larger relative standard error is not determined: so large is that of positions."""
WHAT_DETERMINES = (
    "Straight driving does not determine the focal length. Take a drive with curves, with poses if there are any, or "
    "photograph a board (wayside calibrate IMAGES --board 9x6)."
)


def headline(found: CalibratedDrive) -> str:
    """What the calibration was made of, in a line."""
    c = found.calibration
    return (
        f"{found.log.name}: {found.images} images, {c.ties} ties in {c.segments} segments; "
        f"residual {c.residual:.2f} times that expected of sharp images"
    )


def parameter_lines(found: CalibratedDrive) -> list[str]:
    """Each parameter with its standard error, and what was given."""
    camera, given = found.calibration.camera, found.given
    sigma = np.sqrt(np.diag(found.calibration.covariance))
    d = camera.distortion
    old = None if given is None else changed_camera(given, np.zeros(len(LENS)))
    rows = (
        ("fx", camera.fx, sigma[0] * camera.fx, old and old.fx),
        ("fy", camera.fy, sigma[0] * camera.fy, old and old.fy),
        ("cx", camera.cx, sigma[1], old and old.cx),
        ("cy", camera.cy, sigma[2], old and old.cy),
        ("k1", d[0], sigma[3], old and old.distortion[0]),
        ("k2", d[1], sigma[4], old and old.distortion[1]),
    )
    lines = [f"{'parameter':<10}{'value':>12}{'standard error':>18}{'given':>12}"]
    for name, value, error, was in rows:
        shown = "-" if was is None else f"{was:.6g}"
        lines.append(f"{name:<10}{value:12.6g}{error:18.3g}{shown:>12}")
    return lines


def format_drive(found: CalibratedDrive) -> str:
    """Parameters with standard errors, and whether the camera given agrees."""
    lines = [headline(found), "", *parameter_lines(found), ""]
    if found.given is None:
        lines.append("no calibration was given; centre of the image taken as principal point")
    else:
        lines.append(_comparison(found))
    return "\n".join(lines)


def not_determined(found: CalibratedDrive) -> str:
    """Words of refusal where the drive does not determine the focal length, else empty."""
    sigma = found.calibration.focal_sigma
    if sigma <= LARGEST_SIGMA:
        return ""
    return (
        f"{found.log}: the focal length has a standard error of {100 * sigma:.2f} % ({headline(found)}), which must "
        f"be at most {100 * LARGEST_SIGMA:g} %. {WHAT_DETERMINES}"
    )


def _comparison(found: CalibratedDrive) -> str:
    assert found.given is not None
    off = found.given.fx / found.calibration.camera.fx - 1
    sigmas = abs(off) / found.calibration.focal_sigma
    words = (
        f"the focal length given ({found.source}) is {100 * abs(off):.1f} % "
        f"{'longer' if off > 0 else 'shorter'}, {sigmas:.1f} standard errors"
    )
    return f"{words}: {'it agrees' if sigmas <= 2 else 'it does not agree'}"
