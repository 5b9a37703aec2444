"""Settings of the candidates for sign faces and of the detector that classifies them."""

from __future__ import annotations

from dataclasses import dataclass

from wayside.schemas.settings.field import setting

_CHOSEN = "chosen by hand"
_PITCH = "with 0.22 above and 0.13 below a fifth of the faces in images of streets is not seen"


@dataclass(frozen=True, slots=True)
class CandidateSettings:
    """Where candidates for sign faces come from and how they are classified in one image."""

    keep: int = setting(
        60,
        "candidates",
        "so many of the best in one image may begin landmarks; others may join them",
        low=1,
    )

    # --- which boxes can be faces ---
    narrowest_aspect: float = setting(
        0.2, "", "width over height of a face, at least", origin=_CHOSEN, expert=True, low=0
    )
    widest_aspect: float = setting(
        6.5, "", "width over height of a face, at most", origin=_CHOSEN, expert=True, low=0
    )
    shortest_px: int = setting(
        8,
        "px",
        "height of the smallest face searched for, in images of `shortest_focal_px` and more",
        origin=_CHOSEN,
        expert=True,
        low=1,
    )
    shortest_focal_px: float = setting(
        500.0,
        "px",
        "of a shorter focal length, an image is seen by the detection network twice as large, and faces are searched "
        "for half as tall; of half of it, four times as large",
        origin="four real drives at half size, 360 to 450 px, gain 7 of 48 signs, at three quarters 1 and false rows",
        expert=True,
        low=1,
    )

    other_filled: float = setting(
        0.8,
        "boxes",
        "area of a face of a shape that is not known, or fills no fixed part of its box",
        origin="between a circle and a rectangle",
        expert=True,
        low=0.1,
        high=1,
    )

    # --- merging ---
    same_region_iou: float = setting(
        0.7,
        "IoU",
        "boxes that overlap more are one candidate",
        origin="at 0.45 faces were lost to their neighbours, at 0.6 not",
        expert=True,
        low=0.01,
        high=0.99,
    )

    # --- boxes of the detection network ---
    full_size_px: int = setting(
        176,
        "px",
        "the detection network sees so many rows above and below the optical axis at full size",
        origin="a face of half a metre up to 6 m above the camera is at least 15 px tall beyond; no row is padded",
        expert=True,
        low=0,
    )
    half_size_above: float = setting(
        0.4,
        "tangent",
        "rows above the optical axis that it sees at half size",
        origin=_PITCH,
        expert=True,
    )
    half_size_below: float = setting(
        0.2,
        "tangent",
        "rows below the optical axis that it sees at half size",
        origin=_PITCH,
        expert=True,
    )
    network_least: float = setting(
        -6.0,
        "log odds",
        "of a panel by the detection network: lower ones are no boxes",
        origin=_CHOSEN,
        expert=True,
    )
    network_most: int = setting(
        60,
        "boxes",
        "of the network that are kept in an image, at most",
        origin="120 find no more faces",
        expert=True,
        low=0,
    )
    network_iou: float = setting(
        0.5,
        "IoU",
        "of the network's boxes, those that overlap a better one more are suppressed",
        origin=_CHOSEN,
        expert=True,
        low=0.01,
        high=0.99,
    )

    # --- boxes of another detector, or of a file ---
    external_score: float = setting(
        0.25,
        "",
        "boxes of another detector, or of a file, with a smaller score are left out",
        origin="the default of Ultralytics' predictions",
        low=0,
        high=1,
    )

    # --- classification ---
    same_face_iou: float = setting(
        0.4,
        "IoU",
        "accepted boxes that overlap a better one more are suppressed",
        origin=_CHOSEN,
        expert=True,
        low=0.01,
        high=0.99,
    )
    regressed_from: float = setting(
        -3.0,
        "log odds",
        "boxes of so much by the box network, as a front or a back, are moved onto the panel and classified again",
        origin="the thresholds are near 1, and the second classification adds 2 at most",
        expert=True,
    )
    largest_offset: float = setting(
        1.5,
        "box sizes",
        "box regression: sides move no farther",
        origin=_CHOSEN,
        expert=True,
        low=0,
    )
