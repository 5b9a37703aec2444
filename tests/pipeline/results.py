"""Results of runs made by hand: rows in which everything is null that may be, and the files of a folder."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import shapely
from typer.testing import CliRunner

from wayside.pipeline.cli import app
from wayside.pipeline.logs.importing import ImportOptions, import_images
from wayside.pipeline.reading.calibrations import format_camera
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

NO_MODELS = SimpleNamespace(digests=lambda: {"box": "0"})
"""Stands for the models, whose digests take seconds."""


def sign_row(sign_id, **changes):
    names = dict.fromkeys(("sign_id", "assembly_id"), sign_id) | {"log": "d", "status": "sign"}
    place = dict.fromkeys(("x", "y", "z", "right_m", "down_m", "ahead_m"), 1.0)
    seen = dict.fromkeys(("best_frame", "best_time_ns", "first_frame", "last_frame", "views"), 1)
    return names | place | seen | {"best_box": [0.0, 0.0, 9.0, 9.0]} | changes


def observation_row(frame, number, **changes):
    zeros = dict.fromkeys(("u_px", "v_px", "red", "green", "blue"), 0.0)
    seen = {"frame": frame, "observation_id": number, "source": "level", "verdict": "sign"}
    return zeros | seen | {"box": [0.0, 0.0, 9.0, 9.0], "area_px": 100} | changes


def table_of(table, rows):
    empty = {column.name: None for column in table.columns}
    return pa.Table.from_pylist([empty | row for row in rows], schema=table.schema)


def write_tables(folder, signs=(), observations=(), frames=(), **about):
    """The tables and the `run.json` of a result."""
    folder.mkdir(exist_ok=True)
    for table, rows in ((SIGNS, signs), (OBSERVATIONS, observations), (FRAMES, frames)):
        pq.write_table(table_of(table, rows), folder / table.file)
    (folder / "run.json").write_text(json.dumps(about))
    return folder


def frame_rows(log, spacing_m=8.0, **more):
    """The rows of the images of a log, all used, so far apart along x; `more` is the same in each."""
    read = read_frames(log, ReadSettings(thin_m=0.0), ReadReport())
    return [
        {"frame": n, "log_time_ns": one.log_time_ns, "status": "used"}
        | dict.fromkeys(("x", "station_m"), spacing_m * n)
        | more
        for n, one in enumerate(read)
    ]


def invoke(command, *arguments, status=0):
    """What a command prints that ends with this status; raises what it raises."""
    done = CliRunner().invoke(app, [command, *map(str, arguments)])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == status, done.output
    return done.output


def make_log(log, images):
    """A log of RGB images of 160 x 120 pixels, or of the bytes of their files, 8 m apart."""
    source = log.parent / f"images of {log.name}"
    source.mkdir(parents=True)
    for number, image in enumerate(images):
        if not isinstance(image, bytes):
            image = cv2.imencode(".png", image[..., ::-1])[1].tobytes()
        (source / f"{number:03d}.png").write_bytes(image)
    calibration = log.with_suffix(".yaml")
    calibration.write_text(format_camera(Camera(160, 120, 150.0, 150.0, 80.0, 60.0), "camera"))
    import_images([source], calibration, log, ImportOptions(8.0))
    return log


def read_by_gdal(file):
    """What GDAL says of a file, its columns and points."""
    meta, table = pyogrio.read_arrow(file)
    geometry = meta["geometry_name"] or "wkb_geometry"
    points = shapely.from_wkb(np.array(table.column(geometry).to_pylist(), object))
    return meta, table.drop_columns([geometry]), shapely.get_coordinates(points, include_z=True)
