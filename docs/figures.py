"""Draw a result over an image of its drive, above a map of the drive: the figure of the README.

    .venv/bin/python docs/figures.py recordings/demo.mcap out/demo -o docs/demo.png [--frame N]

Every sign of `signs.parquet` ahead of the camera is put back into the image through its pose in `frames.parquet`, as
a rectangle of the measured size. On the map, north is up where the log knows it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.frame import Camera, Frame
from wayside.schemas.settings import ReadSettings
from wayside.stages.geometry import distort_points

INK = {
    "white": (245, 245, 245),
    "yellow": (40, 200, 245),
    "green": (80, 160, 40),
    "red": (50, 40, 210),
    "orange": (30, 130, 245),
    "blue": (200, 110, 30),
    "brown": (50, 80, 130),
    "fluorescent_yellow_green": (50, 240, 190),
}
FONT, REACH_M, MAP_HEIGHT = cv2.FONT_HERSHEY_SIMPLEX, 90.0, 400


def main() -> None:
    """Draw the figure of one frame."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("-o", "--image", type=Path, required=True)
    parser.add_argument(
        "--frame", type=int, help="frame to draw; default: the one that shows most signs"
    )
    parser.add_argument("--spacing-m", type=float, default=8.04672)
    args = parser.parse_args()
    signs = pq.read_table(args.out / "signs.parquet").to_pylist()
    frames = [
        f for f in pq.read_table(args.out / "frames.parquet").to_pylist() if f["x"] is not None
    ]
    chosen = args.frame
    if chosen is None:
        chosen = max(
            frames,
            key=lambda f: sum(s["first_frame"] <= f["frame"] <= s["last_frame"] for s in signs),
        )["frame"]
    row = next(f for f in frames if f["frame"] == chosen)
    settings = ReadSettings(spacing_m=args.spacing_m)
    frame = next(f for f in read_frames(args.log, settings, ReadReport()) if f.index == chosen)
    image = cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_COLOR)
    draw_signs(image, frame, row, signs)
    band = image[image.shape[0] // 4 : image.shape[0] * 5 // 8]
    sheet = np.vstack([band, draw_map(image.shape[1], frames, row, signs)])
    cv2.imwrite(
        str(args.image), cv2.resize(sheet, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    )


def draw_signs(
    image: NDArray[np.uint8], frame: Frame, row: dict[str, Any], signs: list[dict[str, Any]]
) -> None:
    """Put every sign ahead back into the image, nearest last."""
    if frame.camera is None:
        return
    turn = Rotation.from_quat([row[k] for k in ("qx", "qy", "qz", "qw")]).as_matrix()
    for sign in sorted(signs, key=lambda s: -s["station_m"]):
        local = (
            np.array([sign["x"], sign["y"], sign["z"]]) - [row["x"], row["y"], row["z"]]
        ) @ turn
        if not 4 < local[2] < REACH_M:
            continue
        outline = panel_outline(frame.camera, local, sign["panel_width_m"], sign["panel_height_m"])
        ink = INK.get(sign["color"], (200, 200, 200))
        cv2.polylines(image, [outline], True, (0, 0, 0), 5, cv2.LINE_AA)
        cv2.polylines(image, [outline], True, ink, 3, cv2.LINE_AA)
        words = f"{sign['sign_id'].split('-')[-1]} {local[2]:.1f} m"
        x, y = int(outline[:, 0, 0].min()), int(outline[:, 0, 1].min()) - 8
        if local[2] < 45:
            cv2.putText(image, words, (x, y), FONT, 0.8, (0, 0, 0), 5, cv2.LINE_AA)
            cv2.putText(image, words, (x, y), FONT, 0.8, ink, 2, cv2.LINE_AA)


def panel_outline(
    camera: Camera, centre: NDArray[np.float64], width: float, height: float
) -> NDArray[np.int32]:
    """Image polygon (4, 1, 2) of an upright panel at a camera-frame centre."""
    corners = centre + np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [
        width / 2,
        height / 2,
        0,
    ]
    ideal = corners[:, :2] / corners[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return np.rint(distort_points(camera, ideal)).astype(np.int32).reshape(-1, 1, 2)


def draw_map(
    width: int, frames: list[dict[str, Any]], row: dict[str, Any], signs: list[dict[str, Any]]
) -> NDArray[np.uint8]:
    """Path and signs from above, true to scale, with 2-sigma ellipses no smaller than a dot."""
    height = MAP_HEIGHT
    sheet = np.full((height, width, 3), 28, np.uint8)
    points = np.array([[f["x"], f["y"]] for f in frames] + [[s["x"], s["y"]] for s in signs])
    low, high = points.min(axis=0) - 8, points.max(axis=0) + 8
    scale = min(width / (high[0] - low[0]), (height - 60) / (high[1] - low[1]))

    def at(x: float, y: float) -> tuple[int, int]:
        return round((x - low[0]) * scale), round((high[1] - y) * scale)

    path = np.array([at(f["x"], f["y"]) for f in frames], np.int32).reshape(-1, 1, 2)
    cv2.polylines(sheet, [path], False, (150, 150, 150), 2, cv2.LINE_AA)
    for sign in signs:
        spot = at(sign["x"], sign["y"])
        xx, xy, _, yy, _, _ = sign["covariance"]
        spread, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
        sizes = np.maximum(np.rint(2 * np.sqrt(spread) * scale), 4).astype(int)
        angle = -float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
        ink = INK.get(sign["color"], (200, 200, 200))
        cv2.ellipse(
            sheet, spot, (int(sizes[1]), int(sizes[0])), angle, 0, 360, ink, -1, cv2.LINE_AA
        )
    cv2.circle(sheet, at(row["x"], row["y"]), 7, (255, 255, 255), 2, cv2.LINE_AA)
    cv2.line(sheet, (20, height - 25), (20 + round(50 * scale), height - 25), (220, 220, 220), 2)
    cv2.putText(sheet, "50 m", (20, height - 35), FONT, 0.7, (220, 220, 220), 1, cv2.LINE_AA)
    return sheet


if __name__ == "__main__":
    main()
