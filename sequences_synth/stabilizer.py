"""Electronic stabilization: each frame is warped by the rotation from the true path to a smoothed one.

The warp is that of the middle row, one rotation for the whole frame, as telephones do. The frame then shows what a
virtual camera sees, which has the centre of the true one and the smoothed rotation. A warp of a frame with a rolling
shutter does not undo the shutter.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sequences_synth.arrays import Floats
from sequences_synth.trajectory import rotation_from_vector, vector_from_rotation

# Standard deviation of the Gaussian by which rotations are smoothed. It removes the tremor of a hand and keeps pans.
_SMOOTHING_S = 0.3
# Samples over six standard deviations: the weights of two neighbours differ by less than a third of the largest.
_SAMPLES = 25
#: Largest rotation of the warp. Telephones crop about a tenth of the view on each side; with a field of view of 60 to
#: 70 degrees this is 6 degrees.
LARGEST_WARP_RAD = np.radians(6.0)


def virtual_from_cam(rotation: Callable[[float], Floats], time_s: float) -> Floats:
    """Compute the rotation by which a frame is warped.

    Shapes: returns (3, 3).

    * ``rotation``: Time in seconds -> rotation world_from_cam (3, 3) of the true path.
    * Returns: Its product with a ray of the true camera is the ray of the virtual camera.
    """
    offsets = np.linspace(-3.0, 3.0, _SAMPLES)
    weights = np.exp(-0.5 * offsets**2)
    # The weighted mean of the matrices, projected to the nearest rotation (chordal mean).
    mean = np.einsum("n,nij->ij", weights, np.stack([rotation(time_s + _SMOOTHING_S * x) for x in offsets]))
    left, _, right = np.linalg.svd(mean)
    smoothed = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    vector = vector_from_rotation(smoothed.T @ rotation(time_s))
    angle = float(np.linalg.norm(vector))
    # The bound is smooth, so that the virtual camera does not jerk where the crop ends.
    bounded = LARGEST_WARP_RAD * np.tanh(angle / LARGEST_WARP_RAD)
    return rotation_from_vector(vector * (bounded / angle) if angle > 0 else vector)
