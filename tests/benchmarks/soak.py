"""Runs the online API before a camera that only turns: ``python -m tests.benchmarks.soak --frames 10000 --width 640``.

A camera that does not translate never gets a map, so one :class:`~slam_init.initializer.Initializer` waits all the
time, and judges windows. The images of ``synth:rotation`` are shown forth and back. The table tells, for each tenth of
the frames, the resident memory of the process at its end and the CPU time of a frame. A leak shows as memory that grows
from the second tenth to the last, a search that grows with the history as a time that does.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from tests.benchmarks.options import positive, progress, show

_SOURCE, _RATE_HZ = "synth:rotation", 30.0
_TENTHS = 10


@dataclass(frozen=True)
class Tenth:
    """One tenth of the frames."""

    #: Number of frames up to its end.
    frames: int
    #: Resident memory of the process at its end, in units of 2^20 bytes.
    memory_mb: float
    #: median_ms, p95_ms: Time of a frame on the processor.
    median_ms: float
    p95_ms: float


def soak(images: Sequence[Image], camera: Camera, frames: int) -> Iterator[Tenth]:
    """Show images forth and back to one initializer; yield each tenth of the frames when it is over."""
    import numpy as np

    from slam_init.initializer import Initializer

    initializer, shown = Initializer(camera), itertools.cycle([*images, *images[-2:0:-1]])
    frame = 0
    for tenth in range(1, _TENTHS + 1):
        times_ms: list[float] = []
        while frame < max(tenth * frames // _TENTHS, tenth):
            started = time.process_time()
            if initializer.process(next(shown), frame / _RATE_HZ):
                raise ValueError("the camera does not translate, and there is a map")
            times_ms.append(1e3 * (time.process_time() - started))
            frame += 1
        median_ms, p95_ms = np.percentile(times_ms, [50, 95])
        yield Tenth(frame, memory_mb(), float(median_ms), float(p95_ms))


def memory_mb() -> float:
    """The resident memory now; where the system does not tell it, the largest one up to now."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    except (OSError, ValueError):
        import resource

        unit = 1 if sys.platform == "darwin" else 1024
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def soak_table(tenths: Iterable[Tenth]) -> str:
    """Make the table, in markdown."""
    from slam_init.output.tables import markdown_table, number

    header = ["frames", "memory (MB)", "CPU time per frame (ms): median", "p95"]
    rows = [[str(t.frames), number(t.memory_mb, 1), number(t.median_ms, 1), number(t.p95_ms, 1)] for t in tenths]
    return markdown_table(header, rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.soak", allow_abbrev=False)
    parser.description = "Memory and time per frame of the online API, which waits before a camera that only turns."
    parser.add_argument("--frames", type=positive, default=10_000, metavar="N", help="in all (default: 10000)")
    parser.add_argument("--width", type=positive, default=640, metavar="PX", help="of the images (default: 640)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table to a file as well")
    arguments = parser.parse_args(argv)
    import cv2
    import numpy as np

    from slam_init.datasets import open_source

    cv2.setNumThreads(1)
    source = open_source(_SOURCE)
    if source.camera is None:
        raise ValueError(f"{_SOURCE} has no camera")
    camera = source.camera.scaled(arguments.width / source.camera.width)
    size = (camera.width, camera.height)
    images = [np.asarray(cv2.resize(one.image, size), np.uint8) for one in source.frames(max_frames=40)]
    tenths = soak(images, camera, int(arguments.frames))
    done = list(progress(tenths, "tenth", _TENTHS))
    show(soak_table(done) + "\n", arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
