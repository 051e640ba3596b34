"""What errors of the tracks gain for a translation where the camera only rotates.

The errors of a tracker are not independent from view to view, as noise is. They are measured on rendered images of
cameras that only turn, with a wrong focal length or an unstated distortion. With a rolling shutter, an error of the
turning moves all rows.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.window.levels import LASTING_PX, LASTING_SHARE, SHARED_PX
from slam_init.window.tracks import WindowTracks


def gain_of_lasting_errors(tracks: WindowTracks, R: Floats) -> float:
    """Factor on what a translation gains by chance, for errors that the tracker keeps from view to view.

    Shapes: ``R`` (V, 3, 3).
    """
    cosines = (np.trace(R, axis1=1, axis2=2) - 1) / 2
    displacement_px = tracks.camera.focal_px * float(np.arccos(np.clip(cosines, -1.0, 1.0)).max())
    return 1 + (min(LASTING_SHARE * displacement_px, LASTING_PX) / tracks.residual_px) ** 2


def with_lasting_errors(tracks: WindowTracks, R: Floats) -> WindowTracks:
    """The tracks with the errors that the tracker keeps in the noise.

    Shapes: ``R`` (V, 3, 3).
    """
    noise_px = tracks.noise_px * math.sqrt(gain_of_lasting_errors(tracks, R))
    return replace(tracks.with_noise(noise_px), least_noise_px=noise_px)


def gain_of_shared_errors(tracks: WindowTracks) -> float:
    """Sum of the squares, in units of the noise, of errors that the tracks of a view share."""
    return float(tracks.seen[:, tracks.anchor >= 0].sum()) * (SHARED_PX / tracks.residual_px) ** 2


def gain_of_turning_errors(tracks: WindowTracks, readout_s: float) -> float:
    """Sum of the squares, in units of the noise, of what a rolling shutter moves by errors of the turning."""
    moved_px = readout_s * tracks.sweep_errors[:, None] * np.linalg.norm(tracks.sweep_px_s, axis=2)
    seen = tracks.seen & (tracks.anchor >= 0)
    return float(np.sum((moved_px[seen] / tracks.sigma_px[seen]) ** 2))
