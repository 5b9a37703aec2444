"""Renders one road several times: other motion of the vehicle, other errors of the fixes, signs changed between years.

    python benchmarks/merging_drives.py .cache/passes --frames 48

Between the years every twelfth support is taken away, every twelfth put up, and every twelfth gets another face;
`NAME.truth.json` of each pass lists all panels, `changes.json` which of them changed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from recordings.drives.layout.build import build_scene
from recordings.drives.parts import Quad
from recordings.drives.poses import drive_poses
from recordings.drives.produce import RenderedDrive, _frames, _write
from recordings.drives.render import Renderer
from recordings.drives.scene import Scene
from recordings.drives.spec import CameraSpec, DriveSpec
from recordings.drives.spec_file import load_spec
from recordings.drives.stamps import Output

ROOT = Path(__file__).parents[1]
YEAR_NS = 365 * 86_400 * 10**9
EVERY = 12


@dataclass(frozen=True, slots=True)
class Pass:
    """One drive over the road: its name, the seed of its motion and of its instruments, its year, 0 or 1."""

    name: str
    seed: int
    year: int


PASSES = (
    Pass("first_a", 501, 0),
    Pass("first_b", 502, 0),
    Pass("second_a", 503, 1),
    Pass("second_b", 504, 1),
)


def changed_supports(scene: Scene) -> dict[str, set[int]]:
    """Assemblies that are taken away, put up, or get another face between the years."""
    kinds = sorted({sign.assembly_id for sign in scene.signs})
    return {
        "gone": {a for a in kinds if a % EVERY == 3},
        "new": {a for a in kinds if a % EVERY == 7},
        "changed_face": {a for a in kinds if a % EVERY == 11},
    }


def scene_of(scene: Scene, year: int) -> Scene:
    """The scene as it is in a year."""
    changes = changed_supports(scene)
    absent = changes["gone"] if year else changes["new"]
    of_sign = {sign.sign_id: sign for sign in scene.signs}
    groups = []
    for group in scene.groups:
        fronts = [p.sign_id for p in group.parts if isinstance(p, Quad) and p.sign_id]
        assembly = of_sign[fronts[0]].assembly_id if fronts else -1
        if assembly in absent:
            continue
        if year and assembly in changes["changed_face"]:
            parts = []
            for part in group.parts:
                if isinstance(part, Quad) and part.sign_id:
                    own = of_sign[part.sign_id].face
                    other = next(
                        sign
                        for sign in scene.signs
                        if sign.face.color != own.color and sign.face.shape == own.shape
                    )
                    part = replace(part, texture=other.quad.texture)
                parts.append(part)
            group = replace(group, parts=parts)
        groups.append(group)
    return replace(scene, groups=groups)


def half_size(camera: CameraSpec) -> CameraSpec:
    """A camera of the same view with half as many pixels a side: a quarter of the time."""
    return replace(
        camera,
        width=camera.width // 2,
        height=camera.height // 2,
        fx=camera.fx / 2,
        fy=camera.fy / 2,
        cx=(camera.cx + 0.5) / 2 - 0.5,
        cy=(camera.cy + 0.5) / 2 - 0.5,
    )


def render_pass(spec: DriveSpec, one: Pass, folder: Path) -> Path:
    """Render one pass; its log."""
    moved = replace(spec, name=one.name, seed=one.seed)
    moved = replace(
        moved, log=replace(spec.log, start_ns=spec.log.start_ns + one.year * YEAR_NS + one.seed)
    )
    drive = RenderedDrive(spec)
    drive.scene = scene_of(build_scene(spec, drive.road, drive.poses), one.year)
    drive.poses = drive_poses(moved, drive.road)
    drive.renderer = Renderer(moved, drive.scene, drive.camera)
    drive.spec = moved
    _write(drive, _frames(drive, None, 1), Output(folder))
    changes = {kind: sorted(ids) for kind, ids in changed_supports(drive.scene).items()}
    (folder / "changes.json").write_text(json.dumps(changes))
    return folder / f"{one.name}.mcap"


def main() -> None:
    """Render and run every pass that is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--spec", type=Path, default=ROOT / "recordings/drives/specs/straight.toml")
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--render-only", action="store_true")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    spec = replace(load_spec(given.spec), frames=given.frames)
    spec = replace(spec, camera=half_size(spec.camera))
    logs = {one: given.folder / f"{one.name}.mcap" for one in PASSES}
    for one, log in logs.items():
        if not log.exists():
            render_pass(spec, one, given.folder)
    for one, log in logs.items():
        if given.render_only:
            break
        if not (given.folder / one.name / "run.json").exists():
            command = [str(Path(sys.executable).parent / "wayside"), "run", str(log)]
            subprocess.run(
                [*command, "-o", str(given.folder / one.name), "--workers", "1"], check=True
            )


if __name__ == "__main__":
    main()
