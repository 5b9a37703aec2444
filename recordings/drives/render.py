"""Draws one image: backdrop, then textured quads from far to near, then lens and sensor."""

from dataclasses import dataclass

import cv2
import numpy as np

from recordings.drives.arrays import Bytes, Floats, Singles
from recordings.drives.backdrop.backdrop import Backdrop
from recordings.drives.camera import CameraModel
from recordings.drives.layers import Air, make_layer
from recordings.drives.parts import Group, Part, Quad, Sprite
from recordings.drives.poses import TimedPose
from recordings.drives.scene import Scene
from recordings.drives.sensor import Exposure, Sensor
from recordings.drives.spec import DriveSpec
from recordings.drives.sunlight import sunlight

BEHIND_M = 12.0
CREST_FROM_M = 40.0
"""Ground may hide objects beyond this depth."""
SHADOW_REACH_M = 110.0
_SHADOW_DARKNESS = 0.95


@dataclass(frozen=True, slots=True)
class RenderedImage:
    """One finished frame with what the truth needs."""

    image: Bytes  # (height, width, 3) BGR
    labels: Bytes  # (canvas rows, canvas columns), sign id where a front is seen, else 0
    visible: dict[int, float]  # sign id -> visible fraction of its front


@dataclass(frozen=True, slots=True)
class _Canvas:
    """An image in the making."""

    light: Singles  # (canvas rows, canvas columns, 3)
    depth: Singles  # of the ground, m
    labels: Bytes
    areas: dict[int, float]  # sign id -> pixels of its front if nothing hid it


class Renderer:
    """Draws the images of one drive."""

    def __init__(self, spec: DriveSpec, scene: Scene, camera: CameraModel) -> None:
        self.spec, self.scene, self.camera = spec, scene, camera
        self.sunlight = sunlight(spec.light)
        self.air = Air(self.sunlight.haze, spec.light.haze_m)
        self.backdrop = Backdrop(spec, scene.road, camera, self.sunlight, scene.dapple)
        self.sensor = Sensor(spec, camera)
        self.unseen = camera.unseen()

    def render(self, pose: TimedPose, seconds: float, exposure: Exposure) -> RenderedImage:
        """The image at a pose, so many seconds after the first one."""
        light, depth = self.backdrop.draw(pose)
        canvas = _Canvas(light, depth, np.zeros(depth.shape, np.uint8), {})
        groups = self._far_to_near(pose, seconds)
        self._cast_shadows(canvas, pose, [group for d, group in groups if d < SHADOW_REACH_M])
        for d, group in groups:
            crest = 0.93 * d - 3.0 if d > CREST_FROM_M else 0.0
            for part in group.parts:
                self._paint(canvas, pose, part, crest)
        canvas.labels[self.unseen] = 0
        counts = np.bincount(canvas.labels.ravel(), minlength=256)
        visible = {
            sign: float(min(1.0, counts[sign] / area))
            for sign, area in canvas.areas.items()
            if area > 0
        }
        image = self.sensor.develop(canvas.light, pose.index, exposure)
        return RenderedImage(image, canvas.labels, visible)

    def distorted_labels(self, labels: Bytes) -> Bytes:
        """Canvas labels resampled to the image, (height, width)."""
        camera = self.camera
        return np.asarray(
            cv2.remap(labels, camera.map_x, camera.map_y, cv2.INTER_NEAREST), np.uint8
        )

    def _far_to_near(self, pose: TimedPose, seconds: float) -> list[tuple[float, Group]]:
        """Groups within their reach with their depth, the farthest first."""
        axis = pose.rotation[:, 2]
        groups = []
        for group in self.scene.groups_at(seconds):
            depth = float((group.anchor - pose.position) @ axis)
            if -BEHIND_M < depth < group.reach_m:
                groups.append((depth, group))
        return sorted(groups, key=lambda item: -item[0])

    def _light_on(self, part: Part, quad: Quad, pose: TimedPose) -> Singles:
        """Irradiance on a part, RGB; plants take more light when the sun is behind the camera."""
        sun = self.sunlight
        if isinstance(part, Sprite):
            toward = (quad.origin + quad.v / 2 + quad.u / 2 - pose.position)[:2]
            frontal = -float(toward @ sun.to_sun[:2]) / (np.linalg.norm(toward) + 1e-9)
            return sun.on_surface(0.55 + 0.45 * float(frontal))
        normal = quad.normal()
        if quad.two_sided and normal @ (pose.position - quad.origin) < 0:
            normal = -normal
        return sun.on_surface(max(0.0, float(normal @ sun.to_sun)))

    def _cast_shadows(self, canvas: _Canvas, pose: TimedPose, groups: list[Group]) -> None:
        """Darken the ground along the sun direction; overlapping shadows count once."""
        to_sun = self.sunlight.to_sun
        direct = self.spec.light.sun * float(to_sun[2])
        strength = _SHADOW_DARKNESS * direct / (direct + self.spec.light.ambient)
        if strength < 0.1 or to_sun[2] < 0.1:
            return
        across = np.cross(to_sun, [0, 0, 1.0])
        across /= np.linalg.norm(across)
        shade = np.zeros(canvas.depth.shape, np.float32)
        black = np.zeros(3, np.float32)
        for group in groups:
            level = float(group.anchor[2]) + 0.03
            if level > pose.position[2] - 0.6:
                continue
            for part in group.parts:
                if not part.casts_shadow:
                    continue
                cast = _cast(part, across, to_sun, level)
                layer = make_layer(self.camera, pose, cast, black, self.air, thin=False)
                if layer is not None:
                    region = shade[layer.rows, layer.columns]
                    np.maximum(region, layer.rgba[..., 3], out=region)
        lit = 1 - np.float32(strength) * shade * np.isfinite(canvas.depth)
        np.multiply(canvas.light, lit[..., None], out=canvas.light)

    def _paint(self, canvas: _Canvas, pose: TimedPose, part: Part, crest: float) -> None:
        """Composite one part, but not behind ground nearer than `crest`, and keep the labels of sign fronts."""
        quad = part.quad(pose.position) if isinstance(part, Sprite) else part
        away = np.cross(quad.v, quad.u) @ (pose.position - quad.origin) <= 0
        if away and not quad.two_sided:
            return
        light = self._light_on(part, quad, pose)
        layer = make_layer(self.camera, pose, quad, light, self.air, thin=quad.sign_id == 0)
        if layer is None:
            return
        full = np.count_nonzero(layer.rgba[..., 3] > 0.5) if quad.sign_id else 0
        if crest > 0:
            layer.rgba[canvas.depth[layer.rows, layer.columns] < crest] = 0
        region = canvas.light[layer.rows, layer.columns]
        region *= 1 - layer.rgba[..., 3:]
        region += layer.rgba[..., :3]
        marks = canvas.labels[layer.rows, layer.columns]
        if quad.sign_id:
            marks[layer.rgba[..., 3] > 0.5] = quad.sign_id
            canvas.areas[quad.sign_id] = max(layer.area * quad.fill, float(full))
        elif marks.any():
            marks[layer.rgba[..., 3] > 0.5] = 0


def _cast(part: Part, across: Floats, to_sun: Floats, level: float) -> Quad:
    """The part seen from the sun, laid down on a level plane (m)."""
    upright = part.quad_across(across) if isinstance(part, Sprite) else part
    corners = upright.corners()
    corners = corners - to_sun * ((corners[:, 2] - level) / to_sun[2])[:, None]
    u, v = corners[1] - corners[0], corners[3] - corners[0]
    return Quad(corners[0], u, v, part.texture, two_sided=True)
