"""What a run costs: images per second, processor time by stage, peak memory of a short and of a long log.

    .venv/bin/python benchmarks/costs.py .cache/drives/straight.mcap [--times 20]

The long log is the short one played over and over: its images and calibration only, times moved on, so both run from
the known spacing. Also compares the bytes that one and two workers write, and times the adjustment of windows of
simulated frames. Prints a table; writes nothing but scratch.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from wayside.pipeline.simulation.drive import SimulatedDrive, Survey
from wayside.schemas.settings import MotionSettings
from wayside.stages.mapping import WindowFrame
from wayside.stages.mapping import local_adjustment as bundle

TABLES = ("signs.parquet", "observations.parquet", "frames.parquet")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--spacing", default="26.4ft")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        short, long = folder / "short.mcap", folder / "long.mcap"
        play(args.log, short, 1)
        play(args.log, long, args.times)
        run(short, folder / "warm", args.spacing, 2)  # compiles kernels where no cache is
        digests = {}
        for workers in (1, 2):
            result, peak, processor = run(
                short, folder / f"workers{workers}", args.spacing, workers
            )
            digests[workers] = [result["files"][name]["sha256"] for name in TABLES]
            report(f"short log, {workers} worker(s)", result, peak, processor)
        _, short_peak, _ = run(short, folder / "short", args.spacing, 2)
        result, long_peak, processor = run(long, folder / "long", args.spacing, 2)
        report(f"played {args.times} times over, 2 workers", result, long_peak, processor)
        same = digests[1] == digests[2]
        print(f"the same bytes from 1 and 2 workers: {'yes' if same else 'NO'}")
        print(f"peak memory, long over short: {long_peak / short_peak:.3f}")
        for stage, seconds in result["times"]["cpu_s_by_stage"].items():
            print(
                f"  {stage:10s} {1000 * seconds / result['accounting']['frames_read']:7.1f} ms processor time per image"
            )
    for frames, ties in ((4, 60), (8, 60), (8, 200)):
        print(
            f"  window of {frames} frames, {ties} ties a step: {window_ms(frames, ties):.1f} ms processor time"
        )
    return 0 if same else 1


def window_ms(frames: int, ties: int, times: int = 50) -> float:
    """Processor time of one landmark adjusted with so many frames and ties a step, milliseconds, median."""
    drive = SimulatedDrive(Survey(ties=ties, signs=1))
    moved = [m for m in drive.posed(MotionSettings()) if m.motion is not None]
    seen = np.flatnonzero([len(s.sign) > 0 for s in drive.seen])
    last = int(seen[-1])
    first = last - frames + 1
    held = [WindowFrame.of(m, m.motion, drive.camera) for m in moved[first : last + 1]]
    rays = np.array(
        [(d := p.to_camera(drive.signs[0]))[:2] / d[2] for p in drive.poses[first : last + 1]]
    )
    sighted = bundle.LandmarkRays(np.arange(frames), rays, np.full(frames, 1e-4))
    point = held[-1].motion.pose.to_world(drive.poses[last].to_camera(drive.signs[0]))
    spent = []
    for _ in range(times):
        start = time.process_time()
        bundle.adjust_jointly(held, frames - 1, sighted, point)
        spent.append(time.process_time() - start)
    return 1000 * float(np.median(spent))


def play(source: Path, target: Path, times: int) -> None:
    """Copy images and calibration of a log, `times` over with times moved on."""
    with target.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start()
        channels: dict[int, int] = {}
        shift = 0
        for turn in range(times):
            last = shift
            with source.open("rb") as log:
                first = None
                for schema, channel, message in make_reader(log).iter_messages():
                    if schema is None or not ("Image" in schema.name or "Camera" in schema.name):
                        continue
                    if channel.id not in channels:
                        known = writer.register_schema(schema.name, schema.encoding, schema.data)
                        channels[channel.id] = writer.register_channel(
                            channel.topic, channel.message_encoding, known
                        )
                    first = message.log_time if first is None else first
                    last = max(last, message.log_time - first + shift)
                    when = first + shift + message.log_time - first
                    writer.add_message(
                        channels[channel.id], when, numbered(message.data, turn), when
                    )
            shift = last + 300_000_000
        writer.finish()


def numbered(message: bytes, turn: int) -> bytes:
    """The message with a number in the density of its JPEG, which no decoder heeds: equal images are left out."""
    start = message.find(b"\xff\xd8\xff\xe0")
    if start < 0:
        return message
    density = start + 14  # behind the markers, the length, "JFIF", the version and the unit
    return message[:density] + (turn + 1).to_bytes(4, "big") + message[density + 4 :]


def run(log: Path, out: Path, spacing: str, workers: int, *more: str) -> tuple[dict, float, float]:
    """Run the command as a process of its own; `run.json`, peak memory (MB) and processor seconds."""
    command = [
        sys.executable,
        "-c",
        "from wayside.pipeline.cli import main; main()",
        "run",
        str(log),
        "-o",
        str(out),
        "--overwrite",
    ]
    command += ["--spacing", spacing, "--workers", str(workers), "--set", "read.thin_m=0", *more]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    watch = f"import resource,subprocess,sys; code=subprocess.call({command!r}, stdout=subprocess.DEVNULL); "
    watch += "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(code)"
    done = subprocess.run([sys.executable, "-c", watch], check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return (
        json.loads((out / "run.json").read_text()),
        int(done.stdout.split()[-1]) / 1024,
        processor,
    )


def report(what: str, result: dict, peak: float, processor: float) -> None:
    """Print one line of the table."""
    frames, wall = result["accounting"]["frames_read"], result["times"]["wall_s"]
    print(
        f"{what:36s} {frames:5d} images  {frames / wall:6.1f} images/s  "
        f"{1000 * processor / frames:6.0f} ms processor time per image  peak {peak:.0f} MB",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
