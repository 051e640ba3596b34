"""Relative camera pose from matched bearings, by quaternions (QuEst).

One convention for the whole package: two views of a scene obey ::

    u R m + t = v n

with m, n the rays of one point in camera 1 and camera 2, u, v its depths along them, ``R, t = cam2_from_cam1``.
Quaternions are Hamilton, ordered wxyz. The package knows bearings, no images and no pixels.

* :func:`quest5`, :func:`quest6`, :func:`quest6_fast`, :func:`quest7`, :func:`questn`: rotations from five, six, seven
  or any number of matches, planes included but for :func:`quest7`.
* :data:`SOLVERS`: all of them, and those that they are compared with, by name.
* :func:`translation_and_depths`: translation and depths of a rotation.
* :func:`estimate_relative_pose`: the motion between two views from matches with outliers, and what else explains them.
* :func:`parallax_statement`: whether its translation is observable, with an error rate, and |t|/depth = a +- b.
* :class:`InputError`: what every function raises for an input that it cannot mean; nothing else is raised.

References
----------
.. [F17] K. Fathian, J. P. Ramirez-Paredes, E. A. Doucette, J. W. Curtis, N. R. Gans, "Quaternion Based Camera Pose
   Estimation From Matched Feature Points", arXiv:1704.02672, 2017.
"""

from quest.errors import InputError
from quest.estimate import Hypothesis, NoPose, RelativePose, estimate_relative_pose
from quest.registry import SOLVERS, Solver
from quest.solvers.quest5 import quest5
from quest.solvers.quest6 import quest6
from quest.solvers.quest6_fast import quest6_fast
from quest.solvers.quest7 import quest7
from quest.solvers.questn import questn
from quest.solvers.translation import translation_and_depths
from quest.uncertainty.parallax import ParallaxStatement, parallax_statement

__all__ = [
    "SOLVERS",
    "Hypothesis",
    "InputError",
    "NoPose",
    "ParallaxStatement",
    "RelativePose",
    "Solver",
    "estimate_relative_pose",
    "parallax_statement",
    "quest5",
    "quest6",
    "quest6_fast",
    "quest7",
    "questn",
    "translation_and_depths",
]
