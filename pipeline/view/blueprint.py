"""The layout of the viewer: everything that decides is visible without a click."""

import rerun as rr
import rerun.blueprint as rrb

from wayside.pipeline.view import entities as at
from wayside.schemas.detections import VERDICTS

QUIET = ("score", "size", "overlap", "color", "shape", "unmatched", "few_views", "far_view")
"""Verdicts whose boxes are off at first: too many of them hide the image."""
OFF = (
    *(f"{at.CANDIDATES}/{verdict}" for verdict in VERDICTS if verdict in QUIET),
    *(at.KEYPOINTS, at.SIFT_POINTS, at.SIFT_MATCHES, at.MATCHES, at.OUTLINES),
    *(at.DIFFERENCE, *at.PASSES),
)
"""Layers of the image that are off at first."""
PLOTS = {
    at.RESIDUALS: "residual, px: straight motion orange, adjusted green",
    at.ITERATIONS: "by iteration",
    at.GATES: "candidates by stage",
    at.SIGN_RESIDUALS: "of signs",
    at.WINDOW_RESIDUALS: "windowed adjustment, sigmas: before orange, after green",
}
AROUND = 4.0
"""The image of one sign shows this many times its size on every side."""
GROUND = (20, 22, 26)
"""Background of everything drawn in the colours of signs, white among them, in a light or dark viewer."""
TEXT_ONLY = rrb.TextLogColumns(
    timeline_columns=[rrb.encodings.TimelineColumn(at.FRAME)],
    text_log_columns=[rrb.encodings.TextLogColumn("Body")],
)
"""The frame and the words: the columns that a log has by default leave no room for them."""


def drive_layout(images: str | None = None, *, live: bool = False) -> rrb.Blueprint:
    """The whole drive: image with layers, 3-D behind the vehicle, from above, across the road, plots, table.

    `images`: entity with the images of an imported log, if the recording has none. `live`: show the newest time.
    """
    camera = rrb.Spatial2DView(
        origin=images or at.CAMERA,
        name="camera",
        background=GROUND,
        contents=["$origin/**", f"+ /{at.CAMERA}/**", f"- /{at.CHAINS}/**"],
        overrides={path: rrb.EntityBehavior(visible=False) for path in OFF},
    )
    flat, rays = f"- /{at.CAMERA}/**", f"- /{at.SIGN_RAYS}/**"
    chased = _space(
        "3-D, behind the vehicle",
        [f"+ /{at.WORLD}/**", flat, f"+ /{at.CAMERA}", rays, f"- /{at.NAMES}"],
        eye=(0, -18, -16),
        target=(0, 0, 20),
        hidden=[at.POINTS_STRAIGHT],
    )
    above = _space(
        "from above",
        [f"+ /{at.WORLD}/**", flat, rays, f"- /{at.NAMES_IN_VIEW}", f"- /{at.WORLD}/points/**"],
        eye=(0, -70, 24),
        target=(0, 0, 25),
        up=(0, 0, 1),
    )
    across = rrb.Spatial2DView(origin=at.LOCATION, name="across the road", background=GROUND)
    panels = rrb.Spatial2DView(origin=at.PANELS, name="registered views of panels")
    words = (
        rrb.TextDocumentView(origin=at.INVENTORY, name="inventory"),
        rrb.TextLogView(origin=at.REJECTIONS, name="refused, and why", columns=TEXT_ONLY),
        # Last and not on top: its tiles come over the network, and only when the tab is opened.
        rrb.MapView(origin=at.MAP, name="map"),
    )
    return _laid_out(
        at.FRAME if images is None else at.LOG,
        rrb.Vertical(camera, rrb.Tabs(*words, active_tab=1), row_shares=[3, 1.3]),
        rrb.Vertical(
            chased,
            rrb.Horizontal(above, rrb.Tabs(across, panels)),
            # one over the other: side by side, no title has room for the colours that it names
            rrb.Tabs(*(_plot(origin, name) for origin, name in PLOTS.items())),
            row_shares=[1.6, 1.2, 1],
        ),
        follow=live,
    )


def sign_layout(
    sign_id: str,
    best_range_m: float,
    best_box: tuple[float, float, float, float],
    images: str | None = None,
) -> rrb.Blueprint:
    """One sign: only its own chain of boxes, rays and residuals, and the camera's path; the image is near its box."""
    x, y = (best_box[0] + best_box[2]) / 2, (best_box[1] + best_box[3]) / 2
    reach = AROUND * max(best_box[2] - best_box[0], best_box[3] - best_box[1])
    part = rr.escape_entity_path_part(sign_id)
    camera = rrb.Spatial2DView(
        origin=images or at.CAMERA,
        name=f"{sign_id}: box measured; white: the face by its position and size",
        contents=[f"+ {images or '/' + at.IMAGE}", f"+ /{at.CHAINS}/{part}/**"],
        visual_bounds=rrb.VisualBounds2D(
            x_range=[x - reach, x + reach], y_range=[y - reach, y + reach]
        ),
    )
    own = (f"{at.SIGNS}/{part}/**", f"{at.SIGN_RAYS}/{part}", at.PATH, at.VEHICLE, at.CAMERA)
    space = _space(
        "its rays and 2-sigma ellipsoid",
        [f"+ /{path}" for path in own],
        eye=(-0.3 * best_range_m, -0.4 * best_range_m, -0.4 * best_range_m),
        target=(0, 0, 0.6 * best_range_m),
    )
    residuals = _plot(f"{at.SIGN_RESIDUALS}/{part}", "reprojection residual, px")
    words = rrb.TextDocumentView(origin=f"{at.SIGN_FIGURES}/{part}", name="figures")
    panels = rrb.Spatial2DView(origin=f"{at.SIGN_PANELS}/{part}", name="its registered views")
    iterations = rrb.BarChartView(
        origin=f"{at.SIGN_ITERATIONS}/{part}", name="residual by iteration, sigmas"
    )
    return _laid_out(
        at.FRAME if images is None else at.LOG,
        rrb.Vertical(camera, panels, row_shares=[3, 1]),
        rrb.Vertical(space, rrb.Tabs(residuals, iterations), words, row_shares=[2, 1, 1]),
    )


Triple = tuple[float, float, float]


def _space(
    name: str,
    contents: list[str],
    *,
    eye: Triple,
    target: Triple,
    up: Triple = (0, -1, 0),
    hidden: list[str] | None = None,
) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=at.VEHICLE,
        name=name,
        contents=contents,
        background=GROUND,
        overrides={path: rrb.EntityBehavior(visible=False) for path in hidden or ()},
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=up),
    )


def _plot(origin: str, name: str) -> rrb.TimeSeriesView:
    """A plot without a legend, which would lie on the curves; names show under the pointer."""
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False))


def _laid_out(
    timeline: str,
    left: rrb.Container | rrb.View,
    right: rrb.Container | rrb.View,
    *,
    follow: bool = False,
) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.25, 1]),
        rrb.TimePanel(
            state="collapsed", timeline=timeline, play_state="following" if follow else "paused"
        ),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
