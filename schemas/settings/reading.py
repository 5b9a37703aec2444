"""Which images of a log take part, and how the work is carried out."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class ReadSettings:
    """Which images of the log take part."""

    camera: str = setting("", "topic", "image topic to use; empty: the only one there is")
    calibration: str = setting(
        "", "file", "YAML of ROS camera_info, OpenCV or Kalibr that replaces the log's calibration"
    )
    spacing_m: float = setting(
        0.0, "m", "distance between images where the log has no poses; 0: unknown", low=0
    )
    thin_m: float = setting(
        2.0,
        "m",
        "images are thinned to about this distance; 0: use every image",
        origin="nearer images add cost and no signs, and tell no direction of travel",
        low=0,
    )
    from_s: float = setting(0.0, "s", "start this long after the first image", low=0)
    until_s: float = setting(0.0, "s", "stop this long after the first image; 0: at the end", low=0)
    every: int = setting(1, "images", "use every n-th image only", low=1)
    # Order and faults of what is read
    late_s: float = setting(
        1.5,
        "s",
        "a message is at most so late; times that differ by more tell that a clock was set",
        origin="satellite fixes come once a second",
        expert=True,
        low=0.1,
    )
    far_s: float = setting(
        60.0,
        "s",
        "messages so far from all others have a wrong time; sources that differ by more have clocks of their own",
        origin="clocks of one vehicle that are synchronised at all differ by less",
        expert=True,
        low=1,
    )
    stray_pauses: float = setting(
        60.0,
        "times",
        "the first and last messages of a log, in order, are stray from so many times `far_s` on",
        origin="set by hand",
        expert=True,
        low=1,
    )
    most_stray: float = setting(
        0.1,
        "",
        "fraction of a log that stray messages are at most",
        origin="set by hand",
        expert=True,
        low=0,
        high=1,
    )
    jump_images: float = setting(
        10.0,
        "images",
        "header times tell how long a clock was set, up to so many usual distances of images",
        origin="set by hand",
        expert=True,
        low=1,
    )
    widest_gap_s: float = setting(
        5.0,
        "s",
        "poses and fixes are not interpolated across a longer silence",
        origin="set by hand: a vehicle may turn meanwhile",
        expert=True,
        low=0,
    )
    carried_s: float = setting(
        0.1,
        "s",
        "so far beyond the first or last of them the motion of the last two is carried on",
        origin="set by hand",
        expert=True,
        low=0,
    )
    carried_gaps: float = setting(
        10.0,
        "times",
        "and no farther than so many times the time between these two",
        origin="set by hand: their errors grow by as much",
        expert=True,
        low=0,
    )
    fastest_mps: float = setting(
        150.0,
        "m/s",
        "poses and fixes that imply a higher speed are wrong",
        origin="no vehicle on a road is faster",
        expert=True,
        low=1,
    )
    position_slack_m: float = setting(
        10.0,
        "m",
        "distance that implies no speed",
        origin="satellite fixes scatter by metres within a tenth of a second",
        expert=True,
        low=0,
    )
    hardest_mps2: float = setting(
        15.0,
        "m/s^2",
        "poses aside of a path that implies a higher acceleration are wrong",
        origin="emergency braking reaches 10",
        expert=True,
        low=1,
    )
    spike_m: float = setting(
        0.5,
        "m",
        "poses are so far aside of that path at least",
        origin="smaller errors are weighted down when the path is smoothed",
        expert=True,
        low=0,
    )
    spike_samples: int = setting(
        3,
        "positions",
        "in a row that lie aside of that path, at most; more are another origin",
        origin="set by hand",
        expert=True,
        low=1,
    )
    spike_scatters: float = setting(
        6.0,
        "sigmas",
        "of the series' own scatter that both limits are wider by",
        origin="set by hand: no sound position of normal errors",
        expert=True,
        low=0,
    )
    fastest_turn_dps: float = setting(
        120.0,
        "deg/s",
        "poses that imply a faster rotation there and back are wrong",
        origin="a car on its smallest circle turns by 60",
        expert=True,
        low=1,
    )
    spike_deg: float = setting(
        3.0,
        "deg",
        "poses are turned by so much more at least",
        origin="jolts of the road turn a car by less",
        expert=True,
        low=0,
    )


@dataclass(frozen=True, slots=True)
class RunSettings:
    """How the work is carried out; nothing here changes a result."""

    workers: int = setting(2, "threads", "images processed side by side", low=1, high=64)
    queue: int = setting(4, "frames", "frames waiting at most for each worker", low=1, high=1000)
    memory_mb: float = setting(
        0.0,
        "MB",
        "images that wait, are searched or are tracked take so much at most; 0: what workers and queue come to",
        low=0,
    )


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """Learned numbers: colours, shapes, locations and classifiers."""

    folder: str = setting(
        "", "folder", "model files here replace those that ship, each by its name; empty: none"
    )
    location: str = setting(
        "",
        "file",
        "where signs stand: a model file, or the name of one that ships (report-kansas: the mean of the report); "
        "empty: that of the preset",
    )
    alpha: float = setting(
        0.0,
        "",
        "false-alarm rate of every gate of the preset: the thresholds with the most true positives of at most this "
        "rate, by the curves in the model files; 0: the thresholds of the files",
        low=0,
        high=1,
    )
    network: str = setting(
        "network.onnx",
        "file",
        "detection network, whose boxes are classified and which says what segments are: an ONNX file, or the "
        "name of one that ships; empty: none",
    )
    detector: str = setting(
        "",
        "file",
        "detector (ONNX, YOLO or RT-DETR family) whose boxes replace those of wayside's own detector; empty: none",
    )
    detections: str = setting(
        "",
        "file",
        "boxes made elsewhere (Parquet or COCO JSON) that replace those of wayside's own detector; empty: none",
    )
    classes: str = setting(
        "",
        "file",
        "TOML: which classes of `detector` or `detections` are signs, and their colours and shapes; empty: all are "
        "signs",
    )
    detector_format: str = setting(
        "auto",
        "",
        "how the output of `detector` is read; auto: by its shape and names",
        expert=True,
        choices=(
            "auto",
            "yolov5",
            "yolov8",
            "end_to_end",
            "detr",
            "detr_classes",
            "detr_pixels",
            "detr_logits",
        ),
    )
