"""Folders in which attacks on the outputs take place, and what is found there afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slam_init.output.folder.marker import HOME
from tests.benchmarks.attacks.attack import Ended, command

#: A source that is read in no time, and never initializes.
STILL = "synth:static?frames=2&width=96&height=64"
_NO_MAP = 3


def still(folder: Path, *options: str, out: str = "out") -> Ended:
    """Run on :data:`STILL` in a folder."""
    return command("run", STILL, "--quiet", *options, "--out", out, folder=folder)


def first_run(folder: Path) -> None:
    """Write results to ``out``."""
    ended = still(folder)
    if ended.code != _NO_MAP:
        raise RuntimeError(f"exit code {ended.code}: {ended.err}")


def contents(out: Path) -> dict[str, bytes]:
    """Return the files of a folder without those of the program's hidden folder."""
    found = ((path.relative_to(out).as_posix(), path) for path in out.rglob("*") if path.is_file())
    return {name: path.read_bytes() for name, path in found if not name.startswith(f"{HOME}/")}


def verified(recording: Path) -> bool:
    """Return whether a recording passes ``rerun rrd verify``."""
    environment = os.environ | {"RERUN_ANALYTICS": "false"}
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(recording)],
        env=environment, capture_output=True, check=False,
    )  # fmt: skip
    return done.returncode == 0


@contextmanager
def small_disk(folder: Path, options: str) -> Iterator[Path]:
    """Mount a file system in memory. Only the superuser may do this."""
    place = folder / "disk"
    place.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)], check=True, capture_output=True)
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=False, capture_output=True)
