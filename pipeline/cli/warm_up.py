"""Compile every kernel, after installation: `python -m wayside.pipeline.cli.warm_up LOG` runs a log with each preset.

The machine code is kept in `__pycache__` next to the sources, and no run waits for it later.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from wayside.pipeline.cli.progress import FrameProgress
from wayside.pipeline.files.settings_file import PRESETS, load_settings
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.running.run import Run, RunRequest, run_log
from wayside.pipeline.running.tuning import tune_process, watched_compilation
from wayside.schemas.errors import WaysideError


def warm_up(log: Path) -> None:
    """Run a log with each preset and drop the tables.

    Raises
    ------
    WaysideError
        The log cannot be run.
    """
    tune_process()
    for preset in PRESETS:
        settings, _ = load_settings(preset)
        run = Run()
        with (
            tempfile.TemporaryDirectory(prefix="wayside-") as scratch,
            FrameProgress(preset, run) as progress,
            watched_compilation(progress.compiling),
        ):
            models = load_models(settings)
            run_log(RunRequest(log, Path(scratch), settings, models), run)


if __name__ == "__main__":
    started = time.perf_counter()
    try:
        warm_up(Path(sys.argv[1]))
    except WaysideError as error:
        sys.exit(f"wayside: {error}")
    print(f"compiled in {time.perf_counter() - started:.0f} s")
