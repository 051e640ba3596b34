"""The synthetic experiment of [F17]: ``python -m tests.benchmarks.quest.paper_protocol``.

A camera of 800 px and 640x480 sees points in a box of 2.4 x 1.8 x 3 at a distance of 3 to 6 (or on a plane);
the second camera is rotated by up to 30 degrees and moved by up to 1 along each axis; Gaussian noise is added
in both images. The error is the metric of [F17] with its absolute value restored, ``acos |q . q*| / pi`` in
[0, 1/2], of the candidate closest to the truth; that of the direction of the translation is ``acos (t . t*) / pi``.

"Closest to the truth" favours a solver with many candidates, and the identity alone has an error of .033. So the tables
also give the number of candidates, the error of the candidate that :mod:`quest.paper.selection` ranks first from the
sample alone, and how often refinement on all matches of the pair reaches the end of refinement from the truth. This
refinement starts from the candidate ranked first, or from the best of the first four.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def main(arguments: list[str] | None = None) -> None:
    """Print the tables, write them and the plots."""
    from tests.benchmarks.options import positive, run_on_one_thread
    from tests.benchmarks.quest import paper_tables

    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.quest.paper_protocol", description="The paper's figures."
    )
    parser.add_argument("--problems", type=positive, default=200, help="number of problems a level (default 200)")
    parser.add_argument("--refined", type=positive, default=100, help="how many of them to refine (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the problems (default 0)")
    parser.add_argument("--out", type=Path, help="folder for paper_protocol.md and the plots (needs matplotlib)")
    options = parser.parse_args(arguments)
    if arguments is None:
        run_on_one_thread()
    paper_tables.report(options.problems, options.refined, options.seed, options.out)


if __name__ == "__main__":
    main()
