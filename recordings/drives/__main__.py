"""Command line: python -m recordings.drives SPEC... -o OUT; --help lists the options."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from recordings.drives.produce import render
from recordings.drives.spec import DriveSpec
from recordings.drives.spec_file import SPECS, find_spec, load_spec
from recordings.drives.stamps import Output, is_complete
from wayside.schemas.errors import WaysideError


def _count(text: str) -> int:
    """A number of processes."""
    count = int(text)
    if count < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return count


def _parser() -> argparse.ArgumentParser:
    names = ", ".join(sorted(path.stem for path in SPECS.glob("*.toml")))
    parser = argparse.ArgumentParser(
        prog="python -m recordings.drives",
        description="Render synthetic drives with exact truth.",
        epilog=f"Specifications that come with the repository: {names}.",
    )
    parser.add_argument("specs", nargs="+", metavar="SPEC", help="TOML file, or a name from below")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, help="folder for NAME.mcap and NAME.truth.json"
    )
    parser.add_argument("--jobs", type=_count, default=1, help="processes (default 1)")
    parser.add_argument(
        "--masks", action="store_true", help="also NAME.masks/FRAME.png: sign ids per pixel"
    )
    parser.add_argument("--pictures", action="store_true", help="also NAME.pictures/FRAME.jpg")
    parser.add_argument(
        "--reseed",
        type=int,
        metavar="N",
        help="other drives of the same specifications, named NAME_N: N is added to each seed",
    )
    parser.add_argument("--frames", type=_count, metavar="N", help="frames of every drive")
    parser.add_argument(
        "--varied-posts",
        type=float,
        metavar="M",
        help="as if every drive had signs.varied_posts, and signs.spacing_m = M",
    )
    parser.add_argument(
        "--missing", action="store_true", help="skip drives that are there, made from the same"
    )
    return parser


def asked_for(
    spec: DriveSpec, reseed: int | None, frames: int | None, varied_posts: float | None = None
) -> DriveSpec:
    """The specification with the changes of the command line."""
    if varied_posts is not None:
        signs = replace(spec.signs, varied_posts=True, spacing_m=varied_posts)
        spec = replace(spec, signs=signs)
    if reseed is not None:
        spec = replace(spec, name=f"{spec.name}_{reseed}", seed=spec.seed + reseed)
    return spec if frames is None else replace(spec, frames=frames)


def main() -> int:
    """Render the drives that were asked for; the exit status is 0 if all went well."""
    options = _parser().parse_args()
    output = Output(options.out, options.masks, options.pictures)
    try:
        specs = [load_spec(find_spec(name)) for name in options.specs]
        asked = options.reseed, options.frames, options.varied_posts
        for spec in [asked_for(spec, *asked) for spec in specs]:
            if options.missing and is_complete(spec, output):
                print(f"{spec.name}: complete", file=sys.stderr)
                continue
            render(spec, output, options.jobs)
            print(f"{spec.name}: {spec.frames} frames rendered", file=sys.stderr)
    except WaysideError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
