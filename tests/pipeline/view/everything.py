"""Every field of every type that travels through the flow: the entity that shows it, or why none does.

The list cannot fall behind: a test takes the types from the annotations of the stages, and compares field by field.
"""

from wayside.schemas.detections import (
    Candidates,
    Detections,
    Dropped,
    Features,
    Regions,
    Segmentation,
)
from wayside.schemas.frame import Camera, Fix, Frame, Image, Pose, PosePrior
from wayside.schemas.landmarks import Landmark, Observation, TrackedFrame
from wayside.schemas.measurement import Alignment, Measurement, PanelView, WindowResidual
from wayside.schemas.motion import Motion, PosedDetections, StepPrior, Ties
from wayside.schemas.signs import GlobePosition, Sign, SignCode
from wayside.stages.georeference import DrivePath
from wayside.stages.georeference.path import PathPoint

CAMERA = "/world/vehicle/camera"
LAYER = f"{CAMERA}/candidates"
FIGURES = "/sign_figures"

TIMELINES = "not: the timelines of every row"
WITHIN = "not: of the types inside, each field is shown by itself"
HELD = "not: bytes or numbers for the computer, whose result is shown"
TABLES = "not: a number of the tables, without a place in an image"
WEIGHT = "not: a weight; the standard deviations of the signs that follow are in /sign_figures"
HEIGHT = "not: the heights above the road that follow are in /sign_figures"
COUNTED = "/gates/propose"

EVERYTHING: dict[type, dict[str, str]] = {
    Frame: {
        "index": TIMELINES,
        "log_time_ns": TIMELINES,
        "header_time_ns": TIMELINES,
        "settled_time_ns": TIMELINES,
        "status": "not: shown of frames that are not used, of which the demo has none",
        "encoding": f"{CAMERA}/image",
        "data": f"{CAMERA}/image",
        "camera": CAMERA,
        "width": CAMERA,
        "height": CAMERA,
        "step": HELD,
        "pose": WITHIN,
        "fix": "/map/route",
        "spacing_m": "/residuals/straight",
        "name": TABLES,
        "date": TABLES,
        "grey": "not: a note of the run says it; all colours are unknown then",
    },
    Camera: dict.fromkeys(("width", "height", "fx", "fy", "cx", "cy"), CAMERA)
    | {"distortion": f"{CAMERA}/signs"},
    Pose: dict.fromkeys(("rotation", "centre"), "/world/vehicle"),
    PosePrior: {
        "pose": "/world/points/straight",
        "sigma_m": TABLES,
        "sigma_rad": TABLES,
        "source": TABLES,
    },
    Fix: dict.fromkeys(("latitude_deg", "longitude_deg"), "/map/route")
    | {"altitude_m": FIGURES, "sigma_m": TABLES, "span_s": TABLES},
    Image: {
        "frame": WITHIN,
        "rgb": f"{CAMERA}/image",
        "grey": "not: the image without its colour",
        "levels": "not: the image made smaller",
    },
    Segmentation: {
        "network_score": HELD,
        "image": WITHIN,
        "regions": "/gates/segment",
        "region_count": "/gates/segment",
        "palette": f"{CAMERA}/segments/pass1",
        "difference_levels": f"{CAMERA}/segments/pass2",
        "rows": f"{CAMERA}/segments/pass1",
        "labels": f"{CAMERA}/segments/pass2",
        "dropped": "/gates/segment",
    },
    Dropped: dict.fromkeys(("size", "merged", "left_out"), COUNTED),
    Regions: {
        "box": f"{LAYER}/score",
        "area_px": TABLES,
        "rgb": TABLES,
        "source": COUNTED,
    },
    Candidates: {
        "regions": WITHIN,
        "center": f"{CAMERA}/chains",
        "ideal": f"{CAMERA}/tracks",
        "color": f"{LAYER}/sign",
        "color_distance": f"{LAYER}/sign",
        "shape": f"{LAYER}/sign",
        "shape_distance": f"{LAYER}/sign",
        "score": f"{LAYER}/score",
        "verdict": f"{LAYER}/sign",
        "color_log_probability": "not: the colour of the largest is shown",
        "shape_log_probability": "not: the shape of the largest is shown",
        "back_score": f"{LAYER}/sign",
    },
    Features: {
        "corners": f"{CAMERA}/keypoints",
        "descriptors": HELD,
        "sign_points": f"{CAMERA}/sift_points",
        "sign_descriptors": HELD,
        "sign_rows": "not: the matches that they lead to are shown",
    },
    Detections: {"segmentation": WITHIN, "candidates": WITHIN, "features": WITHIN},
    PosedDetections: {"detections": WITHIN, "motion": WITHIN},
    Motion: {
        "pose": "/world/vehicle",
        "step": "/world/path",
        "covariance": WEIGHT,
        "source": TABLES,
        "baseline_m": "/world/path",
        "station_m": TIMELINES,
        "ties": WITHIN,
        "residual_straight_px": "/residuals/straight",
        "residual_px": "/residuals/adjusted",
        "adjusted": "/iterations",
        "iterations": "/iterations",
        "camera_height_m": HEIGHT,
        "given": "not: a pose of the log, which `view_frame` has no more of; it weighs the path",
        "expected": "/world/points/straight",
        "history_px": "/iterations",
        "length_ratio": TABLES,
        "prior": WITHIN,
    },
    StepPrior: dict.fromkeys(("rotation", "direction", "length_m"), "/world/points/straight")
    | dict.fromkeys(
        ("sigma_rotation", "sigma_direction", "halfway", "sigma_m"),
        WEIGHT,
    ),
    Ties: {
        "previous": f"{CAMERA}/matches",
        "current": f"{CAMERA}/matches",
        "inlier": f"{CAMERA}/matches",
        "point": "/world/points/adjusted",
        "rows": HELD,
        "warp": HELD,
        "sigma_px": WEIGHT,
        "scatter": WEIGHT,
    },
    TrackedFrame: {
        "frame": WITHIN,
        "motion": WITHIN,
        "candidates": WITHIN,
        "track_id": f"{CAMERA}/tracks",
        "residual_px": "/sign_residuals",
        "region_count": "/gates/segment",
        "landmarks": "/world/places",
        "dropped": COUNTED,
        "measurements": WITHIN,
        "matches": f"{CAMERA}/sift_matches",
    },
    Landmark: {
        **dict.fromkeys((f"{what}_log_probability" for what in ("color", "shape", "face")), HELD),
        "track_id": "/world/places",
        "views": f"{CAMERA}/tracks",
        "position": "/world/places",
        "covariance": "/world/signs",
        "right_m": "/location/places",
        "above_m": "/location/places",
        "station_m": "/rejections",
        "best_frame": FIGURES,
        "best_time_ns": FIGURES,
        "best_box": f"{CAMERA}/chains",
        "best_pose": "/world/places",
        "width_m": f"{CAMERA}/signs",
        "height_m": f"{CAMERA}/signs",
        "sigma_width_m": FIGURES,
        "sigma_height_m": FIGURES,
        "facing_deg": "/world/signs",
        "sigma_facing_deg": FIGURES,
        "color": "/world/places",
        "color_distance": FIGURES,
        "shape": "/world/places",
        "shape_distance": FIGURES,
        "score": "/rejections",
        "residual_px": "/rejections",
        "verdict": "/world/places",
        "back": "/world/places",
        "assembly": FIGURES,
        "features": "not: what the classifier made of them, the evidence, is shown",
        "evidence": "/rejections",
        "trajectory": f"{CAMERA}/tracks",
    },
    Observation: {
        "frame": f"{CAMERA}/chains",
        "row": HELD,
        "u_px": f"{CAMERA}/tracks",
        "v_px": f"{CAMERA}/tracks",
        "box": f"{CAMERA}/chains",
        "residual_px": "/sign_residuals",
    },
    Measurement: {
        "track_id": "/panels/outlines",
        "views": "/panels/views",
        "outline": "/panels/outlines",
        "face": "/panels/outlines",
        "shape": "/panels/outlines",
        "adjustment": "/window_residuals/after",
    },
    PanelView: {
        "frame": "/panels/outlines",
        "rgb": "/panels/views",
        "alignment": "/panels/views",
    },
    Alignment: dict.fromkeys(("shift", "stretch", "gain", "bias"), "/panels/views")
    | {"zncc": "/panels/outlines", "covariance": WEIGHT},
    WindowResidual: {
        "first_frame": "/world/adjusted",
        "last_frame": "/world/adjusted",
        "history_sigmas": "/sign_iterations",
        "start": "/world/adjusted",
        "position": "/world/adjusted",
    },
    PathPoint: {
        "frame": TIMELINES,
        "chained": "/world/path",
        "given": "/world/points/straight",
        "fix": "/map/route",
        "time_ns": TIMELINES,
        "covariance": TABLES,
        "source": TABLES,
        "length_ratio": TABLES,
        "station_m": TIMELINES,
        "baseline_m": "/world/path",
        "camera_height_m": HEIGHT,
    },
    DrivePath: {
        "world": TABLES,
        "poses": "/map/route",
        "stations": FIGURES,
        "baselines": TABLES,
        "given_stations": TIMELINES,
        "camera_height_m": HEIGHT,
        "globe": "/map/route",
        "scales": TABLES,
        "notes": "not: words of the summary and of run.json",
    },
    Sign: dict.fromkeys(
        (
            *("number", "assembly", "status", "confidence", "position", "covariance", "centre"),
            *("station_m", "lateral_m", "up_m", "bottom_m", "width_m", "height_m"),
            *("sigma_width_m", "sigma_height_m"),
        ),
        FIGURES,
    )
    | {"landmark": WITHIN, "world_covariance": TABLES, "globe": "/map/signs"}
    | dict.fromkeys(("route", "measure", "measure_unit", "us_probability"), TABLES)
    | {"code": WITHIN},
    SignCode: dict.fromkeys(("code", "legend"), FIGURES)
    | dict.fromkeys(("system", "probability", "nominal_in"), TABLES),
    GlobePosition: dict.fromkeys(("longitude_deg", "latitude_deg"), "/map/signs")
    | {"altitude_m": FIGURES, "sigma_m": FIGURES},
}
