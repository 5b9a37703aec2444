"""Sky over ground, band by band."""

import numpy as np

from recordings.drives.alignment import RoadAlignment
from recordings.drives.arrays import Singles
from recordings.drives.backdrop.ground import Ground
from recordings.drives.backdrop.mesh import SKY, make_facets
from recordings.drives.backdrop.sky import Sky
from recordings.drives.backdrop.tiles import BAND_ROWS, make_tiles
from recordings.drives.camera import CameraModel
from recordings.drives.poses import TimedPose
from recordings.drives.spec import DriveSpec
from recordings.drives.sunlight import Sunlight


class Backdrop:
    """Draws sky, horizon and ground; made once per drive."""

    def __init__(
        self,
        spec: DriveSpec,
        road: RoadAlignment,
        camera: CameraModel,
        sun: Sunlight,
        dapple: Singles | None,
    ) -> None:
        self.road, self.camera = road, camera
        tiles = make_tiles(spec.seed, camera.canvas_width)
        self.sky = Sky(spec.light, sun, tiles, camera)
        self.ground = Ground(spec, sun, tiles, camera, dapple)

    def draw(self, pose: TimedPose) -> tuple[Singles, Singles]:
        """Canvas (rows, columns, 3) with sky and ground, and the depth of the ground (m, infinite for sky)."""
        canvas = np.empty((self.camera.canvas_height, self.camera.canvas_width, 3), np.float32)
        facets = make_facets(self.road, pose, self.camera)
        depth = np.full(canvas.shape[:2], np.inf, np.float32)
        for top in range(0, len(canvas), BAND_ROWS):
            rows = slice(top, min(top + BAND_ROWS, len(canvas)))
            band = canvas[rows]
            ground = facets.ids[rows] != SKY
            if not ground.all():
                band[:] = self.sky.draw(pose, rows)
            if ground.any():
                band[ground], depth[rows][ground] = self.ground.shade(facets, ground, rows)
        return canvas, depth
