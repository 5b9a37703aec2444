"""Every type that travels through the flow: its fields by the entity that shows them, or by why none does.

The list cannot fall behind: a test takes the types from the annotations of the stages, and compares field by field.
A field that holds another of these types needs no mention: each field inside is shown by itself.
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
HELD = "not: bytes or numbers for the computer, whose result is shown"
TABLES = "not: a number of the tables, without a place in an image"
WEIGHT = "not: a weight; the standard deviations of the signs that follow are in /sign_figures"
HEIGHT = "not: the heights above the road that follow are in /sign_figures"
COUNTED = "/gates/propose"

EVERYTHING: dict[type, dict[str, str]] = {
    Frame: {
        TIMELINES: "index log_time_ns header_time_ns settled_time_ns",
        "not: shown of frames that are not used, of which the demo has none": "status",
        f"{CAMERA}/image": "encoding data",
        CAMERA: "camera width height",
        HELD: "step",
        "/map/route": "fix",
        "/residuals/straight": "spacing_m",
        TABLES: "name date",
        "not: a note of the run says it; all colours are unknown then": "grey",
    },
    Camera: {
        CAMERA: "width height fx fy cx cy",
        f"{CAMERA}/signs": "distortion",
    },
    Pose: {"/world/vehicle": "rotation centre"},
    PosePrior: {
        "/world/points/straight": "pose",
        TABLES: "sigma_m sigma_rad source",
    },
    Fix: {
        "/map/route": "latitude_deg longitude_deg",
        FIGURES: "altitude_m",
        TABLES: "sigma_m span_s",
    },
    Image: {
        f"{CAMERA}/image": "rgb",
        "not: the image without its colour": "grey",
        "not: the image made smaller": "levels",
    },
    Segmentation: {
        HELD: "network_score",
        "/gates/segment": "regions region_count dropped",
        f"{CAMERA}/segments/pass1": "palette rows",
        f"{CAMERA}/segments/pass2": "difference_levels labels",
    },
    Dropped: {COUNTED: "size merged left_out"},
    Regions: {
        f"{LAYER}/score": "box",
        TABLES: "area_px rgb",
        COUNTED: "source",
    },
    Candidates: {
        f"{CAMERA}/chains": "center",
        f"{CAMERA}/tracks": "ideal",
        f"{LAYER}/sign": "color color_distance shape shape_distance verdict back_score",
        f"{LAYER}/score": "score",
        "not: the colour of the largest is shown": "color_log_probability",
        "not: the shape of the largest is shown": "shape_log_probability",
    },
    Features: {
        f"{CAMERA}/keypoints": "corners",
        HELD: "descriptors sign_descriptors",
        f"{CAMERA}/sift_points": "sign_points",
        "not: the matches that they lead to are shown": "sign_rows",
    },
    Detections: {},
    PosedDetections: {},
    Motion: {
        "/world/vehicle": "pose",
        "/world/path": "step baseline_m",
        WEIGHT: "covariance",
        TABLES: "source length_ratio",
        TIMELINES: "station_m",
        "/residuals/straight": "residual_straight_px",
        "/residuals/adjusted": "residual_px",
        "/iterations": "adjusted iterations history_px",
        HEIGHT: "camera_height_m",
        "not: a pose of the log, which `view_frame` has no more of; it weighs the path": "given",
        "/world/points/straight": "expected",
    },
    StepPrior: {
        "/world/points/straight": "rotation direction length_m",
        WEIGHT: "sigma_rotation sigma_direction halfway sigma_m",
    },
    Ties: {
        f"{CAMERA}/matches": "previous current inlier",
        "/world/points/adjusted": "point",
        HELD: "rows warp",
        WEIGHT: "sigma_px scatter",
    },
    TrackedFrame: {
        f"{CAMERA}/tracks": "track_id",
        "/sign_residuals": "residual_px",
        "/gates/segment": "region_count",
        "/world/places": "landmarks",
        COUNTED: "dropped",
        f"{CAMERA}/sift_matches": "matches",
    },
    Landmark: {
        HELD: "color_log_probability shape_log_probability face_log_probability",
        "/world/places": "track_id position best_pose color shape verdict back",
        f"{CAMERA}/tracks": "views trajectory",
        "/world/signs": "covariance facing_deg",
        "/location/places": "right_m above_m",
        "/rejections": "station_m score residual_px evidence",
        FIGURES: "best_frame best_time_ns sigma_width_m sigma_height_m sigma_facing_deg color_distance "
        "shape_distance assembly",
        f"{CAMERA}/chains": "best_box",
        f"{CAMERA}/signs": "width_m height_m",
        "not: what the classifier made of them, the evidence, is shown": "features",
    },
    Observation: {
        f"{CAMERA}/chains": "frame box",
        HELD: "row",
        f"{CAMERA}/tracks": "u_px v_px",
        "/sign_residuals": "residual_px",
    },
    Measurement: {
        "/panels/outlines": "track_id outline face shape",
        "/panels/views": "views",
        "/window_residuals/after": "adjustment",
    },
    PanelView: {
        "/panels/outlines": "frame",
        "/panels/views": "rgb alignment",
    },
    Alignment: {
        "/panels/views": "shift stretch gain bias",
        "/panels/outlines": "zncc",
        WEIGHT: "covariance",
    },
    WindowResidual: {
        "/world/adjusted": "first_frame last_frame start position",
        "/sign_iterations": "history_sigmas",
    },
    PathPoint: {
        TIMELINES: "frame time_ns station_m",
        "/world/path": "chained baseline_m",
        "/world/points/straight": "given",
        "/map/route": "fix",
        TABLES: "covariance source length_ratio",
        HEIGHT: "camera_height_m",
    },
    DrivePath: {
        TABLES: "world baselines scales",
        "/map/route": "poses globe",
        FIGURES: "stations",
        TIMELINES: "given_stations",
        HEIGHT: "camera_height_m",
        "not: words of the summary and of run.json": "notes",
    },
    Sign: {
        FIGURES: "number assembly status confidence position covariance centre "
        "station_m lateral_m up_m bottom_m width_m height_m sigma_width_m sigma_height_m",
        TABLES: "world_covariance route measure measure_unit us_probability",
        "/map/signs": "globe",
    },
    SignCode: {
        FIGURES: "code legend",
        TABLES: "system probability nominal_in",
    },
    GlobePosition: {
        "/map/signs": "longitude_deg latitude_deg",
        FIGURES: "altitude_m sigma_m",
    },
}
