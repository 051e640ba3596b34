"""Compile the estimate beforehand, for images and installers: ``python -m quest.compile [--portable]``.

numba compiles each loop at its first call, and the machine code is kept on disk
(:mod:`quest.machine_code`). This program makes the calls, on a general scene, a plane, a rotation and
random matches, so that no user waits. With ``--portable`` the machine code is that of any processor of this kind of
machine, so that an image may run elsewhere than it was built: a tenth slower than code for one processor. It depends on
the versions of Python and of numba.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence

import numpy as np

from quest.estimate import estimate_relative_pose


def main(argv: Sequence[str] | None = None) -> None:
    """Compile the loops of the default solver, and print the time and the folder."""
    parser = argparse.ArgumentParser(prog="python -m quest.compile", allow_abbrev=False)
    parser.description = "Compile the estimate beforehand."
    parser.add_argument("--portable", action="store_true", help="for any processor, not for this one alone")
    if parser.parse_args(argv).portable:
        os.environ["NUMBA_CPU_NAME"] = "generic"  # numba reads it when the kernels are imported
    from quest import jit, machine_code

    begin = time.perf_counter()
    rng = np.random.default_rng(0)
    general = rng.uniform((-1, -1, 3), (1, 1, 6), (60, 3))
    flat = np.column_stack([general[:, :2], np.full(60, 4.0)])
    for points, t in ((general, (0.5, 0.0, 0.1)), (flat, (0.5, 0.0, 0.1)), (general, (0.0, 0.0, 0.0))):
        estimate_relative_pose(points, points + np.array(t) + rng.normal(0, 1e-3, points.shape), scores=range(60))
    estimate_relative_pose(general, rng.permutation(general), max_samples=64)
    folders = machine_code.folders_of(jit.FOLDER)
    seconds = time.perf_counter() - begin
    print(f"compiled in {seconds:.1f} s, kept in {' or '.join(str(folder) for folder in folders)}")


if __name__ == "__main__":
    main()
