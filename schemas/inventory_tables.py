"""The tables of an inventory of many drives, with the conventions of `wayside.schemas.tables`."""

import pyarrow as pa

from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.routes import MEASURE_UNITS
from wayside.schemas.sign_catalogue import CATEGORIES
from wayside.schemas.tables import SIGN_STATUSES, Column, Table, alike

_TEXT, _WHOLE = pa.string(), pa.int32()
_SINGLE, _DOUBLE = pa.float32(), pa.float64()
_CHOICE = pa.dictionary(pa.int8(), pa.string())
_TIME = pa.timestamp("us", tz="UTC")
_NAMES = pa.list_(pa.field("element", pa.string()))
_COVARIANCE = pa.list_(pa.field("element", pa.float64()), 6)
_BOX = pa.list_(pa.field("element", pa.float32()), 4)
_SURE = False

CHANGES_OF_PANELS = {
    "unchanged": "seen in both surveys at one place, with one face",
    "moved": "gone at one place, and one of the same face, size and facing is new nearby",
    "changed_face": "another face at the same place",
    "new": "seen after only; its place was in view before",
    "gone": "seen before only; its place was in view after",
    "not_looked_at": "seen in one survey only; its place was not in view of any drive of the other",
}
CONFIRMED, DENIED = CHANGE_REVIEWS = ("confirmed", "denied")


def _place(what: str) -> tuple[Column, ...]:
    return (
        Column(
            "lon_deg",
            _DOUBLE,
            "deg",
            f"WGS 84 longitude of {what}; null: placed by route and measure",
        ),
        Column("lat_deg", _DOUBLE, "deg", f"WGS 84 latitude of {what}; null likewise"),
        Column("alt_m", _DOUBLE, "m", "height above the WGS 84 ellipsoid; null likewise"),
    )


_GEOMETRY = Column("geometry", pa.binary(), "", "WKB Point Z of lon, lat, alt; null likewise")
_HISTORY = (
    Column("first_seen", _TIME, "", "capture time of its first sighting", _SURE),
    Column("last_seen", _TIME, "", "capture time of its last sighting", _SURE),
    Column("times_seen", _WHOLE, "drives", "drives that saw it", _SURE),
    Column("drives", _NAMES, "", "their names, in order of time", _SURE),
)  # fmt: skip
_ROUTE = (
    Column("route", _TEXT, "", "route, from the largest view of a drive whose route is known; null: none"),
    Column("measure", _DOUBLE, "mi, km, ft or m", "measure along the route, in the unit that `measure_unit` "
           "names; null without a route"),
    Column("measure_unit", _CHOICE, "", "its unit: mile, kilometre, foot or metre", values=tuple(MEASURE_UNITS)),
)  # fmt: skip

PANELS = Table(
    "panels",
    "One row per physical panel of an inventory, merged over all drives that saw it. GeoParquet 1.1.",
    (
        Column("panel_id", _TEXT, "", "drive and `sign_id` of its first sighting", _SURE),
        Column("support_id", _TEXT, "", "the first `panel_id` on its support", _SURE),
        Column("replaces", _TEXT, "", "panel whose face stood here before; null: none known"),
        Column("replaced_by", _TEXT, "", "panel whose face stands here since; null: none known"),
        Column("status", _CHOICE, "", "`sign` where any drive saw its face, else `back`, else `uncertain`", _SURE,
               tuple(SIGN_STATUSES)),
        Column("confidence", _SINGLE, "", "highest confidence of its sightings"),
        Column("color", _CHOICE, "", "colour class that most drives saw", values=COLORS),
        Column("shape", _CHOICE, "", "shape class that most drives saw", values=SHAPES),
        Column("mutcd", _TEXT, "", "MUTCD code or series: narrowest that more drives support than deny; null: none"),
        Column("vienna", _TEXT, "", "the same for the Vienna Convention"),
        Column("category", _CHOICE, "", "purpose of signs of its kind, chosen in the same way", values=CATEGORIES),
        Column("legend", _TEXT, "", "number or direction on the face, chosen in the same way"),
        Column("code_probability", _SINGLE, "", "mean over the drives; a drive with another code counts as 0"),
        *_place("the panel centre"),
        Column("covariance", _COVARIANCE, "m^2", "EE, EN, EU, NN, NU, UU of the position, with the error of a drive",
               _SURE),
        Column("sigma_east_m", _SINGLE, "m", "standard deviation of the longitude", _SURE),
        Column("sigma_north_m", _SINGLE, "m", "standard deviation of the latitude", _SURE),
        Column("sigma_alt_m", _SINGLE, "m", "standard deviation of the height", _SURE),
        Column("bearing_deg", _SINGLE, "deg", "compass direction that the face looks in; null: unknown"),
        Column("panel_width_m", _SINGLE, "m", "width of the face"),
        Column("panel_height_m", _SINGLE, "m", "height of the face"),
        Column("up_m", _SINGLE, "m", "panel centre above the road surface, mean of its sightings"),
        Column("lateral_m", _DOUBLE, "m", "to the right of the path as measures rise; null with a place on WGS 84. "
               "Without, directions and covariances are as if measures rose to the east"),
        *_HISTORY,
        Column("best_drive", _TEXT, "", "drive that saw it largest", _SURE),
        Column("best_sign_id", _TEXT, "", "its row in the `signs.parquet` of that drive", _SURE),
        *_ROUTE,
        _GEOMETRY,
    ),
)  # fmt: skip

SUPPORTS = Table(
    "supports",
    "One row per support: panels that stand, or stood, on one post or hang side by side. GeoParquet 1.1.",
    (
        Column("support_id", _TEXT, "", "the first `panel_id` on it", _SURE),
        *_place("the mean of its panels"),
        Column("panels", _WHOLE, "panels", "panels on it, including past ones", _SURE),
        Column("panel_ids", _NAMES, "", "their ids, in order", _SURE),
        *_HISTORY,
        *_ROUTE,
        _GEOMETRY,
    ),
)  # fmt: skip

SIGHTINGS = Table(
    "sightings",
    "One row per panel and drive: what the drive measured, corrected by the offset of its fixes. GeoParquet 1.1.",
    (
        Column("panel_id", _TEXT, "", "the panel", _SURE),
        Column("drive", _TEXT, "", "folder of the drive's result", _SURE),
        Column("sign_id", _TEXT, "", "row in the `signs.parquet` of the drive", _SURE),
        Column("seen", _TIME, "", "capture time of its best image", _SURE),
        Column("frame", _WHOLE, "", "the frame of that image", _SURE),
        Column("box", _BOX, "px", "the panel in it: x0, y0, x1, y1, half open", _SURE),
        Column("status", _CHOICE, "", "as the drive has it", _SURE, tuple(SIGN_STATUSES)),
        Column("confidence", _SINGLE, "", "as the drive has it"),
        Column("color", _CHOICE, "", "as the drive has it", values=COLORS),
        Column("shape", _CHOICE, "", "as the drive has it", values=SHAPES),
        *_place("the panel as the drive measured it, offset removed,"),
        *alike("offset_east_m offset_north_m offset_up_m", _SINGLE, "m", "error of the drive that was removed",
               _SURE),
        Column("from_panel_m", _SINGLE, "m", "distance to the merged position", _SURE),
        _GEOMETRY,
    ),
)  # fmt: skip

CHANGES = Table(
    "changes",
    "One row per panel that either of two surveys saw. GeoParquet 1.1.",
    (
        Column("change", _CHOICE, "", "kind of change", _SURE, tuple(CHANGES_OF_PANELS)),
        Column("final_change", _CHOICE, "", "`change`; null where a review denies it", values=tuple(CHANGES_OF_PANELS)),
        Column("review", _CHOICE, "", "decision of a reviewer; null: none, or reviewers disagree",
               values=CHANGE_REVIEWS),
        *alike("reviewer review_note", _TEXT, "", "who reviewed it, and the remark"),
        Column("probability", _SINGLE, "", "probability that it is really gone or new, neither missed by the "
               "drives that looked nor a false row; null: other changes"),
        Column("panel_before", _TEXT, "", "panel of the earlier survey; null: none"),
        Column("panel_after", _TEXT, "", "panel of the later survey; null: none"),
        Column("support_id", _TEXT, "", "its support, in the later survey if there is one", _SURE),
        *_place("the panel, in the later survey if it is there,"),
        *alike("color_before color_after", _CHOICE, "", "colour class", values=COLORS),
        *alike("shape_before shape_after", _CHOICE, "", "shape class", values=SHAPES),
        *alike("code_before code_after", _TEXT, "", "code or series with its legend; null: unknown"),
        Column("date_before", _TIME, "", "when the earlier survey saw it last; null: it did not"),
        Column("date_after", _TIME, "", "when the later survey saw it last; null: it did not"),
        Column("distance_m", _SINGLE, "m", "how far it moved; null: not moved"),
        Column("drives_before", _WHOLE, "drives", "drives of the earlier survey that saw it; of what one survey alone "
               "saw also those that had the place in view", _SURE),
        Column("drives_after", _WHOLE, "drives", "drives of the later survey that saw it; of what one survey alone "
               "saw also those that had the place in view", _SURE),
        Column("seen_before", _WHOLE, "drives", "drives of the earlier survey that saw it", _SURE),
        Column("seen_after", _WHOLE, "drives", "drives of the later survey that saw it", _SURE),
        Column("hidden_before", _WHOLE, "drives", "drives of the earlier survey in whose images something nearer "
               "hides the place, which do not count as having it in view", _SURE),
        Column("hidden_after", _WHOLE, "drives", "drives of the later survey in whose images something nearer hides "
               "the place, which do not count as having it in view", _SURE),
        Column("drive_before", _TEXT, "", "drive of the image that shows the place before; null: none does"),
        Column("frame_before", _WHOLE, "", "its frame"),
        Column("box_before", _BOX, "px", "the panel in it, or where it would be: x0, y0, x1, y1, half open"),
        Column("drive_after", _TEXT, "", "drive of the image that shows the place after; null: none does"),
        Column("frame_after", _WHOLE, "", "its frame"),
        Column("box_after", _BOX, "px", "the panel in it, or where it would be: x0, y0, x1, y1, half open"),
        *_ROUTE,
        _GEOMETRY,
    ),
)  # fmt: skip

INVENTORY_TABLES = (PANELS, SUPPORTS, SIGHTINGS, CHANGES)
