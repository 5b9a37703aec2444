"""Which images of a log are used, and how the work is carried out."""

from dataclasses import dataclass

from wayside.schemas.settings.field import setting


@dataclass(frozen=True, slots=True)
class ReadSettings:
    """Which images of the log are used."""

    camera: str = setting("", "topic", "image topic to use; empty: the only image topic")
    calibration: str = setting(
        "", "file", "YAML of ROS camera_info, OpenCV or Kalibr that replaces the log's calibration"
    )
    spacing_m: float = setting(
        0.0, "m", "distance between images if the log has no poses; 0: unknown", low=0
    )
    thin_m: float = setting(
        2.0,
        "m",
        "images are thinned to about this distance; 0: use every image",
        origin="nearer images add cost and no signs, and show no direction of travel",
        low=0,
    )
    from_s: float = setting(0.0, "s", "start this long after the first image", low=0)
    until_s: float = setting(0.0, "s", "stop this long after the first image; 0: at the end", low=0)
    every: int = setting(1, "images", "use every n-th image only", low=1)
    blur: bool = setting(False, "", "blur stored images outside the panels")


@dataclass(frozen=True, slots=True)
class RunSettings:
    """How the work is carried out; nothing here changes the result."""

    workers: int = setting(2, "threads", "images processed in parallel", low=1, high=64)
    memory_mb: float = setting(
        0.0,
        "MB",
        "memory limit for images in progress; 0: depends on the number of workers",
        low=0,
    )


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """Learned models: colours, shapes, locations and classifiers."""

    folder: str = setting(
        "", "folder", "model files here replace shipped ones of the same name; empty: none"
    )
    location: str = setting(
        "",
        "file",
        "where signs stand: a model file, or the name of one that ships (report-kansas: the mean of the report); "
        "empty: that of the preset",
    )
    alpha: str = setting(
        "",
        "",
        "false-alarm rate of every gate of the preset (0.1), or of some (color=0.1,location=0.05): the thresholds with "
        "the most true positives of at most this rate, by the curves in the model files; empty: those of the files",
    )
    network: str = setting(
        "network.onnx",
        "file",
        "detection network, whose boxes are classified: an ONNX file, or the name of one that ships",
    )
    detector: str = setting(
        "",
        "file",
        "detector (ONNX, YOLO or RT-DETR family) whose boxes replace those of wayside's own detector; empty: none",
    )
    detections: str = setting(
        "",
        "file",
        "boxes from another tool (Parquet or COCO JSON) that replace those of wayside's own detector; empty: none",
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
