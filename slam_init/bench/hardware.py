"""The machine and the libraries of a run. Times of different machines cannot be compared."""

from __future__ import annotations

import os
import platform
from pathlib import Path

from slam_init.output.provenance import NOT_INSTALLED, package_versions

#: Packages whose versions may change a figure.
_PACKAGES = ("slam-init", "numpy", "opencv-python-headless", "gtsam", "numba", "poselib", "pysuperansac")


def hardware() -> dict[str, str]:
    """Describe the machine."""
    memory_gb = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    return {
        "processor": _processor(),
        "cores": str(os.cpu_count() or 1),
        "memory": f"{memory_gb:.0f} GB",
        "system": f"{platform.system()} {platform.machine()}",
    }


def versions() -> dict[str, str]:
    """Return the versions of the program and its libraries."""
    found = package_versions(_PACKAGES)
    return {name: number for name, number in found.items() if number != NOT_INSTALLED}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith(("model name", "Model"))]
    return names[0] if names else platform.machine()
