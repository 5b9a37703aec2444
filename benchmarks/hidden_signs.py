"""Whether signs that something hides from a later drive are told from those that were taken away.

    PYTHONPATH=. python benchmarks/hidden_signs.py .cache/hidden straight town

Renders a road twice, a year apart (800 x 600 images, fixes of 1 m). Of four supports in a row the second drive finds
one taken away, one behind bushes and one behind a lorry at rest. Both are merged and compared, and the rows of panels
that faced the drives are counted.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from merging_drives import ROOT, YEAR_NS, half_size

from recordings.drives.layout.build import build_scene
from recordings.drives.layout.vegetation import Foliage
from recordings.drives.paint.vehicles import vehicle
from recordings.drives.parts import UP, Group, PlacedSign, Quad, Sprite
from recordings.drives.poses import drive_poses
from recordings.drives.produce import RenderedDrive, _frames, _write
from recordings.drives.render import Renderer
from recordings.drives.scene import Scene
from recordings.drives.solids import Stand, vehicle_group
from recordings.drives.spec import DriveSpec
from recordings.drives.spec_file import load_spec
from recordings.drives.stamps import Output
from wayside.stages.georeference import LocalOrigin

FATES = ("taken away", "behind bushes", "behind a lorry", "left")
BUSHES = ((3.0, -0.6), (4.0, 0.3), (5.0, -0.2), (3.5, 1.0))
"""Before the support and to its right, m."""
FARTHEST_M = 3.0
"""Of a row from its sign: the fixes err by 1 m."""


def fates(scene: Scene) -> dict[int, str]:
    """What becomes of each assembly that faces the drives."""
    assemblies = sorted({sign.assembly_id for sign in scene.signs if sign.forward})
    return {a: FATES[k % len(FATES)] for k, a in enumerate(assemblies)}


def a_year_later(scene: Scene) -> Scene:
    """The scene with supports taken away and hidden."""
    sign_of = {sign.sign_id: sign for sign in scene.signs}
    fate_of = fates(scene)
    rng = np.random.default_rng(3)
    plants = Foliage(rng, 0.3)
    groups: list[Group] = []
    for group in scene.groups:
        faces = [p.sign_id for p in group.parts if isinstance(p, Quad) and p.sign_id]
        assembly = sign_of[faces[0]].assembly_id if faces else -1
        fate = fate_of.get(assembly)
        if fate == "taken away":
            continue
        groups.append(group)
        if fate in ("behind bushes", "behind a lorry"):
            signs = [sign for sign in scene.signs if sign.assembly_id == assembly]
            groups += hide(scene, signs, fate == "behind bushes", plants, rng)
    return replace(scene, groups=groups)


def hide(
    scene: Scene,
    signs: list[PlacedSign],
    by_bushes: bool,
    plants: Foliage,
    rng: np.random.Generator,
) -> list[Group]:
    """What hides an assembly from the road."""
    road = scene.road
    centre = np.mean([sign.centre() for sign in signs], axis=0)
    along = np.arange(0, road.station[-1] - 20, 2.0)
    middle = np.array([road.surface(station, 0.0) for station in along])
    nearest = int(np.argmin(np.linalg.norm((middle - centre)[:, :2], axis=1)))
    station = float(along[nearest])
    offset = float((centre - middle[nearest]) @ road.axes(station)[1])
    if not by_bushes:
        lorry = vehicle(rng, "truck")
        beside = offset - np.sign(offset) if abs(offset) > 3 else offset
        stand = Stand(station - lorry.length / 2 - 3, beside, 1)
        return [vehicle_group(road, lorry, stand, "lorry")]
    height = max(sign.quad.origin[2] for sign in signs) - middle[nearest][2] + 1.0
    found = []
    for before, right in BUSHES:
        base = road.surface(station - before, offset + right)
        leaves = Sprite(base, UP * height, height * 1.1, plants.pick(rng, "bush"), True)
        found.append(Group("bush", base, [leaves], "bush"))
    return found


def render(spec: DriveSpec, name: str, year: int, folder: Path) -> Scene:
    """Render one drive; the scene of the first one."""
    seed = 501 + year
    log = replace(spec.log, start_ns=spec.log.start_ns + year * YEAR_NS + seed)
    moved = replace(spec, name=name, seed=seed, log=log)
    drive = RenderedDrive(spec)
    scene = build_scene(spec, drive.road, drive.poses)
    drive.scene = a_year_later(scene) if year else scene
    drive.poses = drive_poses(moved, drive.road)
    drive.renderer = Renderer(moved, drive.scene, drive.camera)
    drive.spec = moved
    if not (folder / f"{name}.mcap").exists():
        _write(drive, _frames(drive, None, 1), Output(folder))
    return scene


def survey(start_ns: int, year: int) -> str:
    """The day of a drive, and the next one."""
    day = datetime.fromtimestamp((start_ns + year * YEAR_NS) * 1e-9, UTC).date()
    return f"{day}..{day + timedelta(days=1)}"


def compare(folder: Path, logs: list[Path], start_ns: int) -> list[dict[str, object]]:
    """Rows of the comparison of both drives."""
    tool, inventory = str(Path(sys.executable).parent / "wayside"), folder / "inventory"
    fleet = [tool, "fleet", *map(str, logs), "-o", str(inventory), "--workers", "1"]
    page = str(folder / "changes.html")
    years = ["--before", survey(start_ns, 0), "--after", survey(start_ns, 1)]
    for command in (fleet, [tool, "changes", str(inventory), *years, "-o", page]):
        subprocess.run(command, check=True)
    rows: list[dict[str, object]] = pq.read_table(inventory / "changes.parquet").to_pylist()
    return rows


def main() -> None:
    """Render, run, compare and count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("roads", nargs="+")
    parser.add_argument("--frames", type=int, default=40)
    given = parser.parse_args()
    counts: Counter[tuple[str, str]] = Counter()
    for road in given.roads:
        folder = given.folder / road
        folder.mkdir(parents=True, exist_ok=True)
        spec = load_spec(ROOT / f"recordings/drives/specs/{road}.toml")
        spec = replace(spec, frames=given.frames, camera=half_size(spec.camera))
        spec = replace(spec, log=replace(spec.log, poses=True, fixes=True, raw=False))
        scenes = [render(spec, name, year, folder) for year, name in enumerate(("first", "second"))]
        origin = LocalOrigin(*json.loads((folder / "first.truth.json").read_text())["origin_wgs84"])
        signs = scenes[0].signs
        where, fate_of = np.array([sign.centre() for sign in signs]), fates(scenes[0])
        logs = [folder / f"{name}.mcap" for name in ("first", "second")]
        for row in compare(folder, logs, spec.log.start_ns):
            place = np.array([[row["lon_deg"], row["lat_deg"], row["alt_m"]]], float)
            away = np.linalg.norm((where - origin.topocentric(place))[:, :2], axis=1)
            if row["seen_before"]:
                sign = signs[int(away.argmin())]  # panels of one support have one fate
                fate = fate_of.get(sign.assembly_id, "seen from behind")
                fate = fate if away.min() < FARTHEST_M else "no sign"
                hidden = " (hidden)" if row["hidden_after"] else ""
                counts[fate, f"{row['change']}{hidden}"] += 1
    for (fate, change), count in sorted(counts.items()):
        print(f"{fate:20s} {change:26s} {count:3d}")


if __name__ == "__main__":
    main()
