"""Exchange the pixels of two images of a drive, and count how often the motion stage leaves both out.

    .venv/bin/python benchmarks/reliability_order.py LOG[:SPACING_M] ... [--tries 16] [--images 60] [--seed 5]

The two are 1 to 10 images apart; poses, fixes, times and spacing stay. Whole: images left out of the drive as it is.
"""

from __future__ import annotations

import argparse
import random
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.detections import Candidates, Detections, Regions
from wayside.schemas.frame import OTHER_PLACE
from wayside.schemas.settings import Settings
from wayside.stages.imaging import decode
from wayside.stages.odometry import estimate_motion, extract_features
from wayside.stages.segmentation import unsegmented

APART = (1, 1, 2, 3, 4, 6, 10)
MARGIN = 6
"""Images before and behind the two that take part."""


def used_images(log: Path, spacing_m: float, settings: Settings) -> list[Detections]:
    """The used images of a log with their corners."""
    read = replace(settings.read, spacing_m=spacing_m) if spacing_m else settings.read
    images = (i for i in decode(read_frames(log, read, ReadReport())) if i.frame.used)
    nothing = Candidates.of(Regions.empty())
    found = (Detections(unsegmented(image), nothing) for image in images)
    return list(extract_features(found, settings=settings.features))


def left_out(images: list[Detections], order: list[int], settings: Settings) -> set[int]:
    """Places whose images are left out, where each shows the pixels of the image that `order` names."""
    items = []
    for place, shown in enumerate(order):
        frame = replace(images[place].frame, index=place)
        seen = images[shown]
        image = replace(seen.image, frame=frame)
        items.append(replace(seen, segmentation=replace(seen.segmentation, image=image)))
    motion = estimate_motion(iter(items), settings.motion, settings.ties, settings.adjustment)
    return {item.frame.index for item in motion if item.frame.status == OTHER_PLACE}


def main() -> int:
    """Print a row for each log."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="+")
    parser.add_argument("--tries", type=int, default=16)
    parser.add_argument("--images", type=int, default=60)
    parser.add_argument("--seed", type=int, default=5)
    chosen = parser.parse_args()
    settings = Settings()
    print("| drive | images | whole | tried | both | one | neither | others with them |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for given in chosen.logs:
        name, _, spacing = given.partition(":")
        found = used_images(Path(name), float(spacing or 0), settings)
        images = list(islice(found, chosen.images))
        whole = len(left_out(found, list(range(len(found))), settings))
        draw, counts, others = random.Random(chosen.seed), [0, 0, 0], 0
        for _ in range(chosen.tries):
            apart = draw.choice(APART)
            first = draw.randrange(len(images) - apart)
            start = max(0, first - MARGIN)
            part = images[start : first + apart + 1 + MARGIN]
            a, b = first - start, first - start + apart
            order = list(range(len(part)))
            order[a], order[b] = b, a
            gone = left_out(part, order, settings)
            counts[len(gone & {a, b})] += 1
            others += len(gone - {a, b})
        neither, one, both = counts
        row = Path(name).stem, len(found), whole, chosen.tries, both, one, neither, others
        print("|", *" | ".join(map(str, row)).split(), "|", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
