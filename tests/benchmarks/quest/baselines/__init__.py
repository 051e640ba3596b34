"""The classical solvers that QuEst is compared with: bearings in, quaternions of candidates out.

All are written in batched numpy, so that the comparison is fair and one test suite covers all solvers. The benchmarks
also run the implementations of OpenCV and PoseLib. Each essential matrix gives its two rotations, the twisted pair. The
translation follows from :func:`quest.paper.selection.select_candidates` or :func:`quest.translation_and_depths`, as
for QuEst.
"""

from tests.benchmarks.quest.baselines.eight_point import eight_point
from tests.benchmarks.quest.baselines.five_point import five_point
from tests.benchmarks.quest.baselines.plane import homography
from tests.benchmarks.quest.baselines.seven_point import seven_point
from tests.benchmarks.quest.baselines.six_point import six_point

__all__ = ["eight_point", "five_point", "homography", "seven_point", "six_point"]
