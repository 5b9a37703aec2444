"""Copies the Markdown of the repository for the documentation site, which `make site` builds; needs no network.

Paths stay as they are, so that links between the pages hold. A link to what is no page becomes plain text.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ("*.md", "docs/*", "benchmarks/*.md")
_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#:]+)(#[^)]*)?\)")


def main(target: Path) -> None:
    """Write all pages and pictures that git knows into the folder `target`, which is emptied first."""
    listed = subprocess.run(
        ["git", "ls-files", "--", *PAGES], cwd=ROOT, capture_output=True, text=True, check=True
    )
    names = [name for name in listed.stdout.splitlines() if not name.endswith(".py")]
    shutil.rmtree(target, ignore_errors=True)
    for name in names:
        file = target / name
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix != ".md":
            shutil.copyfile(ROOT / name, file)
            continue

        def link(found: re.Match[str], folder: Path = (ROOT / name).parent) -> str:
            linked = (folder / found[2]).resolve()
            known = linked.is_relative_to(ROOT) and str(linked.relative_to(ROOT)) in names
            return found[0] if known else found[1]

        file.write_text(_LINK.sub(link, (ROOT / name).read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
