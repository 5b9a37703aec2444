"""Structure from motion of the same images by pycolmap, on one thread; in its own process, to measure its cost.

    .venv/bin/python benchmarks/peer.py LOG OUT.npz FRAMES

Calibration known and held; options loosened for a camera that drives ahead, without which no model comes about.
Needs the extra `benchmark`: .venv/bin/pip install pycolmap.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pycolmap

from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings

SEED = 1


def main() -> int:
    """Read images, reconstruct, write poses and points."""
    log, out, count = sys.argv[1:]
    with tempfile.TemporaryDirectory() as scratch:
        model = reconstruct(Path(log), Path(scratch), int(count))
    if model is None:
        print("no model")
        return 1
    write(model, Path(out))
    return 0


def reconstruct(log: Path, scratch: Path, count: int) -> pycolmap.Reconstruction | None:
    """The largest model of the first images of a log."""
    images, database = scratch / "images", scratch / "model.db"
    images.mkdir()
    camera = None
    for frame in read_frames(log, ReadSettings(spacing_m=8.0, thin_m=0.0), ReadReport()):
        if frame.used and frame.camera is not None and frame.index < count:
            (images / f"{frame.index:05d}.jpg").write_bytes(frame.data)
            camera = frame.camera
    if camera is None:
        return None
    pycolmap.set_random_seed(SEED)
    reader = pycolmap.ImageReaderOptions(
        camera_model="FULL_OPENCV", camera_params=",".join(map(str, parameters(camera)))
    )
    extraction = pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=False)
    pycolmap.extract_features(
        database,
        images,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    matching = pycolmap.FeatureMatchingOptions(num_threads=1, use_gpu=False)
    pairing = pycolmap.SequentialPairingOptions(overlap=5, quadratic_overlap=False, num_threads=1)
    pycolmap.match_sequential(
        database, matching_options=matching, pairing_options=pairing, device=pycolmap.Device.cpu
    )
    models = pycolmap.incremental_mapping(database, images, scratch, options=loosened())
    return max(models.values(), key=lambda m: m.num_reg_images(), default=None)


def parameters(camera: Camera) -> list[float]:
    """FULL_OPENCV; pixel centres at halves there, at integers here."""
    k1, k2, p1, p2, k3 = (*camera.distortion, *[0.0] * 5)[:5]
    pinhole = [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]
    return [*pinhole, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]


def loosened() -> pycolmap.IncrementalPipelineOptions:
    """Options for forward motion: small angles between rays, few points per image."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = SEED
    options.extract_colors = False
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    options.mapper.init_min_tri_angle = 2.0
    options.mapper.init_max_forward_motion = 1.0
    options.mapper.filter_min_tri_angle = 0.5
    options.mapper.abs_pose_min_num_inliers = 15
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    options.triangulation.min_angle = 0.5
    return options


def write(model: pycolmap.Reconstruction, out: Path) -> None:
    """Poses (world from camera) by frame, and points with all their pixels."""
    frames, rotations, centres, seen, points = [], [], [], [], []
    for image in sorted(model.images.values(), key=lambda i: i.name):
        if not image.has_pose:
            continue
        pose = image.cam_from_world().inverse()
        frames.append(int(Path(image.name).stem))
        rotations.append(pose.rotation.matrix())
        centres.append(pose.translation)
        for point in image.points2D:
            if point.has_point3D():
                seen.append((frames[-1], *(point.xy - 0.5)))
                points.append(model.points3D[point.point3D_id].xyz)
    np.savez(
        out,
        frames=np.array(frames),
        rotations=np.array(rotations),
        centres=np.array(centres),
        seen=np.array(seen),
        points=np.array(points),
    )


if __name__ == "__main__":
    sys.exit(main())
