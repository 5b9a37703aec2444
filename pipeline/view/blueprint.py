"""The layout of the viewer: everything that decides is visible without a click."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from wayside.pipeline.view import entities as at
from wayside.schemas.detections import VERDICTS

QUIET = (
    "score",
    "size",
    "overlap",
    "color",
    "shape",
    "unmatched",
    "few_views",
    "far_view",
)
"""Verdicts whose boxes are there, but off: too many of them hide the image."""
AROUND = 4.0
"""The image of one sign shows this many times its size on every side."""
FLAT = f"- /{at.CAMERA}/**"
NO_RAYS = f"- /{at.SIGN_RAYS}/**"
GROUND = (20, 22, 26)
"""Behind everything that is drawn in the colours of signs, white among them, whether the viewer is light or dark."""
NO_LEGEND = rrb.PlotLegend(visible=False)
"""A legend lies on the curves; names show under the pointer."""
TEXT_ONLY = rrb.TextLogColumns(
    timeline_columns=[rrb.encodings.TimelineColumn(at.FRAME)],
    text_log_columns=[rrb.encodings.TextLogColumn("Body")],
)
"""The frame and the words: the columns that a log has by default leave no room for them."""


def drive_layout(images: str | None = None, *, live: bool = False) -> rrb.Blueprint:
    """The whole drive: image with layers, 3-D behind the vehicle, from above, across the road, plots, table.

    images: entity of the images of an imported log, where the recording has none of its own; live: the time
    follows what comes in.
    """
    hidden = [f"{at.CANDIDATES}/{verdict}" for verdict in VERDICTS if verdict in QUIET]
    hidden += [at.KEYPOINTS, at.SIFT_POINTS, at.SIFT_MATCHES, at.MATCHES, at.OUTLINES]
    hidden += [at.DIFFERENCE, *at.PASSES]
    camera = rrb.Spatial2DView(
        origin=images or at.CAMERA,
        name="camera",
        background=GROUND,
        contents=["$origin/**", f"+ /{at.CAMERA}/**", f"- /{at.CHAINS}/**"],
        overrides={path: rrb.EntityBehavior(visible=False) for path in hidden},
    )
    chased = rrb.Spatial3DView(
        origin=at.VEHICLE,
        name="3-D, behind the vehicle",
        contents=[f"+ /{at.WORLD}/**", FLAT, f"+ /{at.CAMERA}", NO_RAYS, f"- /{at.NAMES}"],
        background=GROUND,
        overrides={at.POINTS_STRAIGHT: rrb.EntityBehavior(visible=False)},
        eye_controls=rrb.EyeControls3D(
            position=[0, -18, -16], look_target=[0, 0, 20], eye_up=[0, -1, 0]
        ),
    )
    above = rrb.Spatial3DView(
        origin=at.VEHICLE,
        name="from above",
        contents=[
            f"+ /{at.WORLD}/**",
            FLAT,
            NO_RAYS,
            f"- /{at.NAMES_IN_VIEW}",
            f"- /{at.WORLD}/points/**",
        ],
        background=GROUND,
        eye_controls=rrb.EyeControls3D(
            position=[0, -70, 24], look_target=[0, 0, 25], eye_up=[0, 0, 1]
        ),
    )
    across = rrb.Spatial2DView(origin=at.LOCATION, name="across the road", background=GROUND)
    residuals = rrb.TimeSeriesView(
        origin=at.RESIDUALS,
        name="residual, px: straight motion orange, adjusted green",
        plot_legend=NO_LEGEND,
    )
    iterations = rrb.TimeSeriesView(
        origin=at.ITERATIONS, name="by iteration", plot_legend=NO_LEGEND
    )
    gates = rrb.TimeSeriesView(origin=at.GATES, name="candidates by stage", plot_legend=NO_LEGEND)
    signs = rrb.TimeSeriesView(origin=at.SIGN_RESIDUALS, name="of signs", plot_legend=NO_LEGEND)
    window = rrb.TimeSeriesView(
        origin=at.WINDOW_RESIDUALS,
        name="windowed adjustment, sigmas: before orange, after green",
        plot_legend=NO_LEGEND,
    )
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
            rrb.Tabs(residuals, iterations, gates, signs, window),
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
    own = [
        f"+ /{path}"
        for path in (
            f"{at.SIGNS}/{part}/**",
            f"{at.SIGN_RAYS}/{part}",
            at.PATH,
            at.VEHICLE,
            at.CAMERA,
        )
    ]
    space = rrb.Spatial3DView(
        origin=at.VEHICLE,
        name="its rays and 2-sigma ellipsoid",
        contents=own,
        background=GROUND,
        eye_controls=rrb.EyeControls3D(
            position=[-0.3 * best_range_m, -0.4 * best_range_m, -0.4 * best_range_m],
            look_target=[0, 0, 0.6 * best_range_m],
            eye_up=[0, -1, 0],
        ),
    )
    residuals = rrb.TimeSeriesView(
        origin=f"{at.SIGN_RESIDUALS}/{part}",
        name="reprojection residual, px",
        plot_legend=NO_LEGEND,
    )
    words = rrb.TextDocumentView(origin=f"{at.SIGN_FIGURES}/{part}", name="figures")
    panels = rrb.Spatial2DView(origin=f"{at.SIGN_PANELS}/{part}", name="its registered views")
    iterations = rrb.BarChartView(
        origin=f"{at.SIGN_ITERATIONS}/{part}", name="residual by iteration, sigmas"
    )
    timeline = at.FRAME if images is None else at.LOG
    left = rrb.Vertical(camera, panels, row_shares=[3, 1])
    plots = rrb.Tabs(residuals, iterations)
    return _laid_out(timeline, left, rrb.Vertical(space, plots, words, row_shares=[2, 1, 1]))


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
