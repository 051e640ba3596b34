"""How well a true trajectory knows its positions, by its own noise.

A rendered trajectory is smooth to the last digits. A measured one is noisy from pose to pose. This noise is a small
part of its error: the clocks, the calibration of the camera and a rolling shutter add errors that change slowly.
"""

from __future__ import annotations

import numpy as np

from slam_init.types.pose import Trajectory

#: Accuracy of measured positions. The makers of TUM RGB-D state 1 cm for their motion capture (Sturm et al. 2012).
#: Depth tracking, such as KinectFusion in 7-Scenes, is no better. Their noise from pose to pose is .1 to .9 mm.
#: Class: assumption, in metres.
_MEASURED_M = 0.01
#: Noise over the median step beyond which positions are measured. It is .03 to .12 in TUM RGB-D, 7-Scenes and poses of
#: a checkerboard, and below .001 in rendered sequences and for the GPS and gyroscopes of KITTI.
#: Class: measured.
_NOISY = 0.01
#: Poses further apart in time are those of photographs: their steps differ by the motion, and not by noise.
#: Class: assumption, in seconds.
_SLOWEST_S = 0.2
#: Fewer poses do not tell the noise.
#: Class: level.
_FEWEST = 8
#: Median length of the third differences of positions whose coordinates have a noise of 1: the variance is 20, and the
#: median of chi-square with three degrees of freedom 2.37.
#: Class: geometry.
_THIRD_DIFFERENCE = float(np.sqrt(20 * 2.37))


def position_sigma_m(truth: Trajectory) -> float:
    """Standard deviation of the true positions; 0 where nothing tells that they are measured."""
    positions = np.array([pose.t for pose in truth.world_from_cam])
    if len(positions) < _FEWEST or np.median(np.diff(truth.timestamps_s)) > _SLOWEST_S:
        return 0.0
    step, third = (float(np.median(np.linalg.norm(np.diff(positions, n, axis=0), axis=1))) for n in (1, 3))
    return _MEASURED_M if third / _THIRD_DIFFERENCE > _NOISY * step else 0.0
