"""The fixed piece of work that all times are compared with, and the description of the machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path


def flow_ms() -> float:
    """The fixed piece of work: the flow of 400 points in an image of 640x480 pixels."""
    return median_ms(_flow(), 21, time.perf_counter)


def cpu_flow_ms() -> float:
    """The same in CPU time, for times of a busy machine."""
    return median_ms(_flow(), 21, time.thread_time)


def _flow() -> Callable[[], object]:
    import cv2
    import numpy as np

    rng = np.random.default_rng(0)
    large = rng.integers(0, 255, (60, 80), dtype=np.uint8)
    image = cv2.GaussianBlur(cv2.resize(large, (660, 500), interpolation=cv2.INTER_CUBIC), (5, 5), 1.0)
    before, after = (np.ascontiguousarray(image[y : y + 480, x : x + 640]) for x, y in ((0, 0), (4, 3)))
    points = rng.uniform((40, 40), (600, 440), (400, 2)).astype(np.float32)
    return lambda: cv2.calcOpticalFlowPyrLK(before, after, points, np.empty_like(points), winSize=(21, 21), maxLevel=3)


def median_ms(work: Callable[[], object], calls: int, clock: Callable[[], float]) -> float:
    """Median time of some calls in milliseconds."""
    import numpy as np

    times = []
    for _ in range(calls):
        begin = clock()
        work()
        times.append(1e3 * (clock() - begin))
    return float(np.median(times))


def machine() -> str:
    """Describe the CPU model and the versions, without anything that identifies the machine."""
    import platform

    import cv2
    import numpy as np

    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, OpenCV {cv2.__version__}"
    return f"One thread on {model}; {versions}."
