"""The tables of a result, and that of its checks: every column with its type, unit and meaning.

Columns are never renamed; new ones may be added, which raises no version. Null means unknown, never 0. Units and words
also travel in the field metadata of the files, so that a table explains itself (`pyarrow.parquet.read_schema`).
"""

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pyarrow as pa

from wayside.schemas.detections import COLORS, SHAPES, SOURCES, VERDICTS
from wayside.schemas.frame import FRAME_STATUSES
from wayside.schemas.landmarks import EVIDENCE_TERMS
from wayside.schemas.roadside import GROUND_STATUSES, POST_KINDS, SIDES
from wayside.schemas.routes import MEASURE_UNITS
from wayside.schemas.sign_catalogue import CATEGORIES

SCHEMA_VERSION = 1
"""Raised only where a column changes its meaning."""

SIGN_STATUSES = {
    "sign": "a panel whose face is seen",
    "back": "a panel seen from behind",
    "uncertain": "a face whose confidence is below the setting `locate.confidence`, or that of the rate `models.alpha`",
}
MOTION_SOURCES = {
    "start": "first used frame: the origin of the drive",
    "straight": "straight motion with the known spacing",
    "odometry": "odometry of the log",
    "poses": "poses of the log",
    "fixes": "satellite fixes of the log",
    "points": "the spacing varies: the length follows points seen in the step before, too",
    "speed": "no pose, spacing or fix: the speed over the step before",
}


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table."""

    name: str
    """Of the column."""
    type: pa.DataType
    """In Arrow."""
    unit: str
    """Empty: none."""
    words: str
    """What it means."""
    nullable: bool = True
    """Whether it may be unknown."""
    values: tuple[str, ...] = ()
    """What a dictionary column may hold."""

    @property
    def arrow(self) -> "pa.Field[Any]":
        """The Arrow field, unit and words in its metadata."""
        return pa.field(
            self.name, self.type, self.nullable, metadata={"unit": self.unit, "words": self.words}
        )


def alike(names: str, *about: Any, **more: Any) -> tuple[Column, ...]:
    """Columns that differ in their names alone, which stand with blanks between."""
    return tuple(Column(name, *about, **more) for name in names.split())


@dataclass(frozen=True)
class Table:
    """One Parquet file of a result, its columns in order."""

    name: str
    """Of the file, without suffix."""
    words: str
    """What a row is."""
    columns: tuple[Column, ...]

    @property
    def file(self) -> str:
        """Name of the file in the result folder."""
        return f"{self.name}.parquet"

    @cached_property
    def schema(self) -> pa.Schema:
        """The Arrow schema, its version in the metadata under the key `wayside`."""
        about = json.dumps({"table": self.name, "schema_version": SCHEMA_VERSION})
        return pa.schema([c.arrow for c in self.columns], metadata={"wayside": about})


_TEXT, _FLAG = pa.string(), pa.bool_()
_WHOLE, _LONG, _SINGLE, _DOUBLE = pa.int32(), pa.int64(), pa.float32(), pa.float64()
_CHOICE = pa.dictionary(pa.int8(), pa.string())
_BOX = pa.list_(pa.field("element", pa.float32()), 4)
_COVARIANCE = pa.list_(pa.field("element", pa.float64()), 6)
_SURE = False  # `nullable` of a column that is always known
DATE = Column(
    "date",
    pa.timestamp("us", tz="UTC"),
    "",
    "the capture time as a date; null: the log counts from 0",
)
_WGS84 = (
    *alike("lon_deg lat_deg", _DOUBLE, "deg", "WGS 84 longitude and latitude; null without fixes"),
    Column("alt_m", _DOUBLE, "m", "height above the WGS 84 ellipsoid; null without fixes"),
)

SIGNS = Table(
    "signs",
    "One row per physical panel, numbered by station, then lateral offset. GeoParquet 1.1 where the log has fixes.",
    (
        Column("sign_id", _TEXT, "", "log stem and number: `drive-0001`", _SURE),
        Column("assembly_id", _TEXT, "", "id that panels on one support share", _SURE),
        Column("log", _TEXT, "", "stem of the log's file name", _SURE),
        Column("status", _CHOICE, "", "what kind of row this is", _SURE, tuple(SIGN_STATUSES)),
        Column("confidence", _SINGLE, "", "calibrated probability that it is a sign, 0 to 1; null in the presets of "
               "the report. Boxes of another detector: from its scores, see detectors.md"),
        Column("color", _CHOICE, "", "colour class of the face", values=COLORS),
        Column("color_distance", _SINGLE, "", "Mahalanobis distance to that class (eq. 3.1); only the presets of the "
               "report"),
        Column("shape", _CHOICE, "", "shape class of the face", values=SHAPES),
        Column("shape_distance", _SINGLE, "", "Mahalanobis distance to that class; only preset `report-shape`"),
        Column("x", _DOUBLE, "m", "panel centre in the world frame (`run.json` names it)", _SURE),
        *alike("y z", _DOUBLE, "m", "panel centre in the world frame", _SURE),
        Column("covariance", _COVARIANCE, "m^2", "xx, xy, xz, yy, yz, zz of x, y, z"),
        Column("sigma_along_m", _SINGLE, "m", "standard deviation along the path at the sign"),
        Column("sigma_lateral_m", _SINGLE, "m", "standard deviation across the path"),
        Column("sigma_up_m", _SINGLE, "m", "standard deviation upward"),
        Column("station_m", _DOUBLE, "m", "along the travelled path from the first used frame"),
        Column("lateral_m", _DOUBLE, "m", "to the right of the path, positive"),
        Column("up_m", _DOUBLE, "m", "panel centre above the road surface"),
        Column("bottom_m", _DOUBLE, "m", "lower edge above the road surface"),
        Column("sigma_bottom_m", _SINGLE, "m", "standard deviation of the lower edge, the road's included"),
        Column("panel_width_m", _SINGLE, "m", "width of the face"),
        Column("panel_height_m", _SINGLE, "m", "height of the face"),
        Column("sigma_width_m", _SINGLE, "m", "standard deviation of the width"),
        Column("sigma_height_m", _SINGLE, "m", "standard deviation of the height"),
        Column("facing_deg", _SINGLE, "deg", "normal of the visible side relative to the reverse of travel: 0 faces "
               "the camera, right turn positive; null where it was not measured"),
        Column("sigma_facing_deg", _SINGLE, "deg", "standard deviation of the facing"),
        Column("bearing_deg", _SINGLE, "deg", "compass direction that the face looks in, clockwise from north; null "
               "without fixes or facing"),
        Column("lon_deg", _DOUBLE, "deg", "WGS 84 longitude; null without fixes"),
        Column("lat_deg", _DOUBLE, "deg", "WGS 84 latitude; null without fixes"),
        Column("alt_m", _DOUBLE, "m", "height above the WGS 84 ellipsoid; null without fixes"),
        Column("sigma_east_m", _SINGLE, "m", "standard deviation of the longitude; null without fixes"),
        Column("sigma_north_m", _SINGLE, "m", "standard deviation of the latitude; null without fixes"),
        Column("sigma_alt_m", _SINGLE, "m", "standard deviation of the height; null without fixes"),
        Column("geometry", pa.binary(), "", "WKB Point Z of lon, lat, alt; null without fixes"),
        Column("best_frame", _WHOLE, "", "frame whose image shows it largest and whole", _SURE),
        Column("best_time_ns", _LONG, "ns", "capture time of that frame", _SURE),
        DATE,
        Column("best_box", _BOX, "px", "its box there: x0, y0, x1, y1, half open", _SURE),
        *alike("right_m down_m ahead_m", _DOUBLE, "m", "panel centre in the camera frame of `best_frame`", _SURE),
        Column("first_frame", _WHOLE, "", "first frame it was measured in", _SURE),
        Column("last_frame", _WHOLE, "", "last frame it was measured in", _SURE),
        Column("views", _WHOLE, "frames", "frames it was measured in", _SURE),
        Column("residual_px", _SINGLE, "px", "RMS reprojection error, full-resolution pixels"),
        *(
            Column(f"evidence_{term}", _SINGLE, "log odds", f"evidence for a sign: {words}")
            for term, words in EVIDENCE_TERMS.items()
        ),
        Column("route", _TEXT, "", "route that the vehicle was on; null where none is given or found"),
        Column("measure", _DOUBLE, "mi, km, ft or m", "measure along `route` abreast of the sign, in the unit "
               "that `measure_unit` names; null without a route"),
        Column("measure_unit", _CHOICE, "", "its unit: mile, kilometre, foot or metre", values=tuple(MEASURE_UNITS)),
        Column("mutcd", _TEXT, "", "MUTCD code, or its series if the code is uncertain; sign_codes.md"),
        Column("vienna", _TEXT, "", "the same for the Vienna Convention, for faces of that system"),
        Column("category", _CHOICE, "", "purpose of signs of its kind, also if the code is not known; null: "
               "uncertain", values=CATEGORIES),
        Column("legend", _TEXT, "", "number or direction on the face; null: none, or uncertain"),
        Column("code_probability", _SINGLE, "", "probability of the code in `mutcd` or `vienna`"),
        Column("nominal_width_in", _SINGLE, "in", "standard width that agrees with the measured one (of a "
               "diamond: side of its square); null: none or several"),
        Column("nominal_height_in", _SINGLE, "in", "the same for the height"),
        Column("next_sign_id", _TEXT, "", "next sign ahead of the same code (else colour and shape), on the same side, "
               "facing the same way, on another support; null: none"),
        Column("spacing_m", _DOUBLE, "m", "distance to it along the path, horizontal if the log has poses or fixes"),
        Column("sigma_spacing_m", _SINGLE, "m", "standard deviation of the spacing: of the stretch between both"),
        Column("radius_m", _DOUBLE, "m", "radius of the path abreast of the sign, positive in a right turn; null: "
               "straight, or within 40 m of an end of the path"),
        Column("sigma_radius_m", _SINGLE, "m", "standard deviation of the radius"),
    ),
)  # fmt: skip

OBSERVATIONS = Table(
    "observations",
    "One row per candidate past the colour gate or the network, with its verdict. In order of frame, then row.",
    (
        Column("frame", _WHOLE, "", "index of the frame in the log", _SURE),
        DATE,
        Column("observation_id", _LONG, "", "number of the row in the log, from 0", _SURE),
        Column("source", _CHOICE, "", "`pass1`, `pass2`: colour clusters. `network`: detection network. `predicted`: "
               "reprojected from other frames. `moved`: one of these after box regression. `external`: another "
               "detector, or a file. `level`, `stack`: earlier versions", _SURE, SOURCES),
        Column("box", _BOX, "px", "x0, y0, x1, y1, half open", _SURE),
        Column("area_px", _WHOLE, "px", "pixels of the region", _SURE),
        Column("u_px", _DOUBLE, "px", "measured centre, as recorded (distorted), right", _SURE),
        Column("v_px", _DOUBLE, "px", "measured centre, as recorded (distorted), down", _SURE),
        *alike("u_ideal_px v_ideal_px", _DOUBLE, "px", "the same without lens distortion"),
        *alike("red green blue", _SINGLE, "", "mean of the region, 0 to 255", _SURE),
        Column("color", _CHOICE, "", "most probable colour class of a box above the classifier's threshold; presets "
               "of the report: the nearest", values=COLORS),
        Column("color_distance", _SINGLE, "", "Mahalanobis distance to it (eq. 3.1); only the presets of the report"),
        Column("shape", _CHOICE, "", "most probable shape class of a box above the classifier's threshold; preset "
               "`report-shape`: the nearest", values=SHAPES),
        Column("shape_distance", _SINGLE, "", "Mahalanobis distance to it; only preset `report-shape`"),
        Column("track_id", _WHOLE, "", "track it belongs to; null: none"),
        Column("sign_id", _TEXT, "", "row of `signs.parquet` it belongs to; null: none"),
        Column("verdict", _CHOICE, "", "`sign`, or the reason for rejection", _SURE, VERDICTS),
        Column("residual_px", _SINGLE, "px", "distance to the reprojected landmark"),
        Column("score", _SINGLE, "", "log odds that the box is a sign face, by the classifier of boxes or another "
               "detector; null: not computed"),
    ),
)  # fmt: skip

FRAMES = Table(
    "frames",
    "One row per image message of the chosen camera, used or not, in the order they were taken in.",
    (
        Column("frame", _WHOLE, "", "index of the frame in the log, from 0", _SURE),
        Column("log_time_ns", _LONG, "ns", "time at which it was logged", _SURE),
        Column("header_time_ns", _LONG, "ns", "time of capture; null where not set"),
        DATE,
        Column("status", _CHOICE, "", "`used`, or why not", _SURE, FRAME_STATUSES),
        *alike("x y z", _DOUBLE, "m", "camera centre in the world frame"),
        *alike("qx qy qz qw", _DOUBLE, "", "camera in world, quaternion"),
        Column("station_m", _DOUBLE, "m", "along the travelled path from the first used frame"),
        Column("motion_source", _CHOICE, "", "prior of the motion", values=tuple(MOTION_SOURCES)),
        Column("baseline_m", _DOUBLE, "m", "distance from the previous used frame; 0: a duplicate"),
        Column("ties", _WHOLE, "points", "tie points to the previous used frame"),
        Column("residual_straight_px", _SINGLE, "px", "eq. 7.5 with the motion of the prior"),
        Column("residual_px", _SINGLE, "px", "eq. 7.5 with the motion that was used"),
        Column("adjusted", _FLAG, "", "whether the motion was adjusted"),
        Column("iterations", _WHOLE, "", "iterations of the adjustment"),
        Column("regions", _WHOLE, "", "connected regions of both passes of segmentation; null where the frame is not "
               "used"),
        Column("outside_size", _WHOLE, "", "regions of any source with too few or too many pixels, or no height or "
               "aspect of a face; null where the frame is not used"),
        Column("left_out", _WHOLE, "", "boxes of the detection network not classified, because it takes others for "
               "likelier faces; null where the frame is not used"),
        Column("candidates", _WHOLE, "", "regions classified; null where the frame is not used"),
        Column("image_name", _TEXT, "", "name of the imported file; null: not imported"),
        Column("image_date", _TEXT, "", "when it was taken, as its camera wrote it into the file (local time); null: "
               "unknown"),
        Column("lon_deg", _DOUBLE, "deg", "WGS 84 longitude of the camera; null without fixes"),
        Column("lat_deg", _DOUBLE, "deg", "WGS 84 latitude of the camera; null without fixes"),
        Column("alt_m", _DOUBLE, "m", "height above the WGS 84 ellipsoid; null without fixes"),
        Column("heading_deg", _SINGLE, "deg", "compass direction the camera looks in, clockwise from north; null "
               "without fixes"),
    ),
)  # fmt: skip

CHECK_VERDICTS = ("meets", "fails", "unclear", "not checkable")

CHECKS = Table(
    "checks",
    "One row per rule and sign that it holds for, in order of the rules. `wayside check` writes it.",
    (
        Column("rule", _TEXT, "", "name of the rule in its file", _SURE),
        Column("words", _TEXT, "", "what the rule says", _SURE),
        *alike("edition section", _TEXT, "", "manual that the rule is from, and section or table; null: not stated"),
        Column("level", _TEXT, "", "`shall`: a standard. `should`: a guidance. `own`: from no manual", _SURE),
        Column("sign_id", _TEXT, "", "row of `signs.parquet`", _SURE),
        Column("code", _TEXT, "", "its code or series with the legend; null: not known"),
        Column("verdict", _CHOICE, "", "`meets`, `fails`: at least two standard deviations inside or outside the "
               "limits. `unclear`: nearer to a limit. `not checkable`: `missing` says why", _SURE, CHECK_VERDICTS),
        Column("probability", _DOUBLE, "", "probability that the rule is broken; null: not checkable"),
        Column("quantity", _TEXT, "", "what was compared; its name ends in its unit", _SURE),
        *alike("value sigma", _DOUBLE, "", "value of the quantity, and its standard deviation (0: exact)"),
        *alike("least most", _DOUBLE, "", "limits, including the tolerance; null: none"),
        Column("missing", _TEXT, "", "what the rule needs but is not known; null: nothing"),
    ),
)  # fmt: skip

PROFILE = Table(
    "profile",
    "Only with `--roadside`. One row per station and offset: the ground across the road every 8 m of the route.",
    (
        Column("station_m", _DOUBLE, "m", "along the travelled path from the first used frame", _SURE),
        Column("offset_m", _DOUBLE, "m", "to the right of the path, positive", _SURE),
        Column("height_m", _DOUBLE, "m", "height of the ground above the road under the camera; null: `unseen`"),
        Column("sigma_m", _SINGLE, "m", "standard deviation of the height; without poses in the log it holds a roll "
               "of the camera of 0.5 degrees"),
        Column("count", _WHOLE, "pairs", "pairs of images that show the strip", _SURE),
        Column("status", _CHOICE, "", ". ".join(f"`{name}`: {words}" for name, words in GROUND_STATUSES.items()), _SURE,
               tuple(GROUND_STATUSES)),
        Column("frame", _WHOLE, "", "last used frame before the station", _SURE),
        *alike("x y z", _DOUBLE, "m", "point on the ground in the world frame"),
        *_WGS84,
    ),
)  # fmt: skip

SECTIONS = Table(
    "sections",
    "Only with `--roadside`. One row per station and side: lines, edges and slopes. Distances are from the path, "
    "outwards.",
    (
        Column("station_m", _DOUBLE, "m", "along the travelled path from the first used frame", _SURE),
        Column("side", _CHOICE, "", "side of the path, in the direction of travel", _SURE, SIDES),
        Column("lane_width_m", _SINGLE, "m", "between the nearest painted lines of both sides, middle to middle"),
        Column("line_m", _SINGLE, "m", "distance of the nearest painted line"),
        Column("edge_m", _SINGLE, "m", "distance of the edge of the travelled way: outermost solid line within 8 m"),
        Column("shoulder_m", _SINGLE, "m", "distance of the first break of the ground: the outer edge of the shoulder"),
        Column("ditch_m", _SINGLE, "m", "distance of the second break: the bottom of the ditch, or the top of a bank"),
        Column("ditch_height_m", _SINGLE, "m", "height there, above the road"),
        *alike("fore_slope back_slope", _SINGLE, "", "ground before and beyond the ditch, rise over run: -0.25 falls "
               "1:4"),
    ),
)  # fmt: skip

POSTS = Table(
    "posts",
    "Only with `--roadside`. One row per support: what its lowest sign stands on.",
    (
        Column("assembly_id", _TEXT, "", "support, as in `signs.parquet`", _SURE),
        Column("sign_id", _TEXT, "", "its lowest sign", _SURE),
        Column("number", _WHOLE, "", "number of posts that are seen; null: none"),
        Column("width_m", _SINGLE, "m", "width of one post across the line of sight; null: none is seen"),
        Column("sigma_width_m", _SINGLE, "m", "standard deviation of the width"),
        Column("kind", _CHOICE, "", ". ".join(f"`{name}`: {words}" for name, words in POST_KINDS.items()), _SURE,
               tuple(POST_KINDS)),
        Column("kind_probability", _SINGLE, "", "probability of the kind; null: not determined from its appearance"),
        Column("views", _WHOLE, "", "images that show them", _SURE),
        Column("frame", _WHOLE, "", "`best_frame` of the sign", _SURE),
        *alike("x y z", _DOUBLE, "m", "centre of the sign in the world frame", _SURE),
        *_WGS84,
    ),
)  # fmt: skip

ROADSIDE = (PROFILE, SECTIONS, POSTS)
"""Of a run with `roadside.on`."""
TABLES = (SIGNS, OBSERVATIONS, FRAMES, *ROADSIDE)
