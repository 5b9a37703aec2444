"""Settings of a drive. Every group is one table of the TOML file; the defaults are a plain highway."""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

RoadKind: TypeAlias = Literal["two_lane", "four_lane", "street", "forest"]
DialectName: TypeAlias = Literal["protobuf", "ros2", "json"]
Compression: TypeAlias = Literal["zstd", "lz4", "none"]


@dataclass(frozen=True, slots=True)
class PathSpec:
    """How the camera vehicle moves along the road."""

    spacing_m: float = 8.04672  # 26.4 ft
    trigger_sigma_m: float = 0.01
    dropped: tuple[int, ...] = ()  # trigger numbers that took no image
    speed_mps: float = 27.0
    heading_deg: float = 80.0  # compass heading at station 0
    wander_m: float = 0.12  # slow lateral drift inside the lane


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """Pinhole camera with Brown distortion and its mount on the vehicle."""

    width: int = 1600
    height: int = 1200
    fx: float = 1400.0
    fy: float = 1400.0
    cx: float = 799.5
    cy: float = 599.5
    distortion: tuple[float, float, float, float, float] = (0.0,) * 5  # k1 k2 p1 p2 k3
    mount_height_m: float = 2.0
    mount_yaw_deg: float = 0.5  # right positive
    mount_pitch_deg: float = 0.5  # up positive
    mount_roll_deg: float = 0.2  # clockwise positive
    jitter_pitch_deg: float = 0.15
    jitter_roll_deg: float = 0.12
    jitter_yaw_deg: float = 0.08
    jitter_height_m: float = 0.012


@dataclass(frozen=True, slots=True)
class RoadSpec:
    """Alignment and cross-section of the road."""

    kind: RoadKind = "two_lane"
    segments: tuple[tuple[float, float], ...] = ((2000.0, 0.0),)
    """Length (m) and radius (m, positive to the right, 0 for a straight) of each piece."""
    hills: tuple[tuple[float, float, float], ...] = ()
    """Amplitude (m), wavelength (m) and phase (rad) of each wave of the profile."""
    centre_line: Literal["dashed", "solid", "double"] = "dashed"
    shoulder_m: float = 1.0
    side_roads: tuple[float, ...] = ()  # stations, m
    gantries: tuple[float, ...] = ()
    bridges: tuple[float, ...] = ()
    guardrails: tuple[tuple[float, float, float], ...] = ()  # from, to, side (+1 right)


@dataclass(frozen=True, slots=True)
class LightSpec:
    """Sun, sky, haze and the slow drift of exposure and white balance."""

    sun_azimuth_deg: float = 210.0  # compass
    sun_elevation_deg: float = 45.0
    sun: float = 0.85
    ambient: float = 0.28
    warmth: float = 0.0  # 0 neutral, 1 sunset
    cloud_cover: float = 0.35
    sky_brightness: float = 1.0
    haze_m: float = 2500.0
    glare: float = 0.0
    dapple: float = 0.0
    exposure: float = 1.15
    exposure_drift: float = 0.05
    white_balance_drift: float = 0.02


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """Densities of roadside objects; counts are per 100 m of road unless named otherwise."""

    trees: float = 5.0
    bushes: float = 8.0
    weeds: float = 12.0
    forest: float = 0.0
    fences: bool = True
    utility_side: int = -1  # -1 left, +1 right, 0 none
    buildings: float = 0.5
    silos: float = 0.15
    shops: float = 0.0
    billboards: float = 0.5
    mailboxes: float = 0.4
    delineators: float = 1.5
    bales: float = 0.5
    barrels: float = 0.0
    parked: float = 0.0
    oncoming: float = 0.8
    leading: int = 1  # vehicles ahead in the travelled lane
    overtaking: int = 0
    season: float = 0.3  # 0 lush green, 1 dry


@dataclass(frozen=True, slots=True)
class SignSpec:
    """Density and mix of signs; weights are relative."""

    spacing_m: float = 28.0
    first_m: float = 24.0
    left_share: float = 0.15
    back_share: float = 0.5  # opposite-direction assemblies per forward assembly
    twisted_share: float = 0.25
    leaning_share: float = 0.2
    hidden_share: float = 0.1
    faded_share: float = 0.25
    groups: dict[str, float] = field(default_factory=lambda: {"warning": 1.0, "regulatory": 1.0})
    chevrons: bool = True
    varied_posts: bool = (
        False  # width, profile, colour, rust and shade of posts, which the truth then states
    )
    setback_m: float = 0.0  # how far beyond the usual strip beside the road signs may stand


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """Lens and sensor finish of an image."""

    vignette: float = 0.25
    blur_px: float = 0.45
    motion_blur_px: float = 0.8
    noise: float = 1.6  # grey levels at mid grey
    sharpen: float = 0.5
    contrast: float = 1.0  # power of the light: above 1, deep shadows and early highlights
    mosaic: bool = False  # one colour a pixel (RGGB), the others from its neighbours
    jpeg_quality: int = 90


@dataclass(frozen=True, slots=True)
class LogSpec:
    """Dialect of the log and which side channels it carries."""

    dialect: DialectName = "protobuf"
    raw: bool = False
    compression: Compression = "zstd"
    chunk_kib: int = 1024  # 0 writes no chunks
    index: bool = True
    poses: bool = True
    fixes: bool = True
    start_ns: int = 1_720_000_000_000_000_000
    latency_ms: float = 12.0  # log time after header time
    origin: tuple[float, float, float] = (38.5, -98.2, 520.0)  # WGS 84 deg, deg, m
    pose_sigma_m: float = 0.01
    pose_sigma_deg: float = 0.03
    fix_sigma_m: float = 1.0


@dataclass(frozen=True, slots=True)
class DriveSpec:
    """Everything one drive is made from."""

    name: str
    seed: int
    frames: int
    path: PathSpec = field(default_factory=PathSpec)
    camera: CameraSpec = field(default_factory=CameraSpec)
    road: RoadSpec = field(default_factory=RoadSpec)
    light: LightSpec = field(default_factory=LightSpec)
    scene: SceneSpec = field(default_factory=SceneSpec)
    signs: SignSpec = field(default_factory=SignSpec)
    sensor: SensorSpec = field(default_factory=SensorSpec)
    log: LogSpec = field(default_factory=LogSpec)
