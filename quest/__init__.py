"""Relative camera pose from matched bearings, by quaternions (QuEst).

One convention for the whole package: two views of a scene obey ::

    u R m + t = v n

with m, n the rays of one point in camera 1 and camera 2, u, v its depths along them, ``R, t = cam2_from_cam1``.
Quaternions are Hamilton, ordered wxyz. All functions take bearings; :func:`estimate_relative_pose_px` alone takes
pixels.

* :func:`quest5`, :func:`quest6`, :func:`quest6_fast`, :func:`quest7`, :func:`questn`: rotations from five, six, seven
  or any number of matches. All but :func:`quest7` solve points on a plane too.
* :func:`translation_and_depths`: the translation and the depths that go with a rotation;
  :func:`translation_and_depths_printed`: the same as the paper prints it.
* :func:`estimate_relative_pose`: the motion between two views from matches with outliers, and the other motions that
  explain the matches as well.
* :func:`refine_relative_pose`: the same from a known pose, without samples.
* :func:`estimate_relative_pose_px`: the same from pixels, the camera matrix and the distortion of each view.
* :func:`estimate_upright_pose`: the same where gravity is known, from samples of three matches.
* :func:`estimate_shared_focal`: the same from pixels of one camera whose focal length is not known, with its deviation.
* :func:`estimate_relative_poses`: many pairs at once, on threads.
* :func:`parallax_statement`: whether the translation is observable, with an error rate, and |t|/depth = a +- b.
* :class:`InputError`: the only exception that these functions raise for a wrong input.

numba is loaded when a compiled loop is first used.

References
----------
.. [F17] K. Fathian, J. P. Ramirez-Paredes, E. A. Doucette, J. W. Curtis, N. R. Gans, "Quaternion Based Camera Pose
   Estimation From Matched Feature Points", arXiv:1704.02672, 2017.
"""

from importlib.metadata import PackageNotFoundError, version

from quest.errors import InputError
from quest.estimate import estimate_relative_pose, estimate_relative_poses, refine_relative_pose
from quest.focal import SharedFocal, estimate_shared_focal
from quest.gravity import estimate_upright_pose
from quest.paper.printed import translation_and_depths_printed
from quest.paper.quest5 import quest5
from quest.paper.quest6 import quest6
from quest.paper.quest6_fast import quest6_fast
from quest.paper.quest7 import quest7
from quest.paper.questn import questn
from quest.paper.translation import translation_and_depths
from quest.pixels import estimate_relative_pose_px
from quest.relative_pose import Hypothesis, NoPose, PoseEvidence, RelativePose
from quest.uncertainty.parallax import ParallaxStatement, parallax_statement

__all__ = [
    "Hypothesis",
    "InputError",
    "NoPose",
    "ParallaxStatement",
    "PoseEvidence",
    "RelativePose",
    "SharedFocal",
    "estimate_relative_pose",
    "estimate_relative_pose_px",
    "estimate_relative_poses",
    "estimate_shared_focal",
    "estimate_upright_pose",
    "parallax_statement",
    "quest5",
    "quest6",
    "quest6_fast",
    "quest7",
    "questn",
    "refine_relative_pose",
    "translation_and_depths",
    "translation_and_depths_printed",
]

_DISTRIBUTIONS = ("slam-init", "quest-relpose")


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module 'quest' has no attribute {name!r}")
    for distribution in _DISTRIBUTIONS:
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return "0+unknown"


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
