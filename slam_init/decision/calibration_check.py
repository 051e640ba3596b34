"""A translation before a plane, or a turning camera whose stated focal length is wrong: a check to tell them apart.

A camera that turns by R, while its focal length is stated wrong by a factor s, shows ``n ~ D R D^-1 m`` with
``D = diag(1, 1, s)`` (a pinhole; a fisheye follows it near the axis only): in stated bearings a homography of four
unknowns. To an estimator that takes the calibration for granted it looks like a plane and a translation, with every
point in front of both cameras. A real translation is not of this form, except where it is too small to be told from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quest.robust.rotation import refine_rotation_compiled
from quest.robust.spatial_blocks import directions_of, scatter_of_sum
from slam_init.types.arrays import Floats

__all__ = ["TurningCamera", "suspected_focal_factor", "turning_camera"]

#: Factors tried: calibrations from memory or from a data sheet are off by up to a tenth.
_FACTORS = np.linspace(0.9, 1.1, 21)
#: Calibrations are rarely better than a hundredth without care; twice that is worth a word.
_LEAST_OFF = 0.02
#: By how much the free focal length must be better: chi-square of one degree of freedom, once in 15 000 cases; and in
#: standard deviations of what regions of the view say, so that no body that moves by itself decides.
_LEAST_GAIN, _LEAST_GAIN_Z = 16.0, 3.0
#: Squared lengths count up to three standard deviations in each of their two components.
_GATE2 = 18.0


@dataclass(frozen=True)
class TurningCamera:
    """The best pure rotation with a free focal length.

    Attributes
    ----------
    focal_factor : float
        The true focal length over the stated one.
    residual_rad : float
        What it leaves unexplained: the standard deviation of a component of a bearing, by the median over the matches.
        For a camera that does turn this is the noise.
    stated_residual_rad : float
        What the best rotation with the stated focal length leaves.
    matches : int
        What the medians are over.
    gain, gain_z : float
        What the free focal length takes from the squared residuals, in units of their variance, and in units of the
        scatter of that sum.
    """

    focal_factor: float
    residual_rad: float
    stated_residual_rad: float
    matches: int
    gain: float
    gain_z: float

    @property
    def chance_factor(self) -> float:
        """By which a residual exceeds its expectation once in 30 000 cases.

        The median of N lengths with two Gaussian components each has a standard deviation of 0.72 / sqrt(N), relative.
        """
        return 1 + 4 * 0.72 / float(np.sqrt(max(self.matches, 1)))

    def off_rotation_rad(self, noise_rad: float) -> float:
        """What no rotation under the stated calibration explains, beside the noise: it tells a translation."""
        return float(np.sqrt(max(self.stated_residual_rad**2 - noise_rad**2, 1e-24)))


def turning_camera(m: Floats, n: Floats, noise_rad: float) -> TurningCamera:
    """Fit a rotation and a focal factor to matches.

    Parameters
    ----------
    m, n : (N, 3) float
        Bearings under the stated calibration.
    noise_rad : float
        Standard deviation of a component of a bearing, roughly: the scale down to which the fit is robust.
    """
    lengths = np.empty((len(_FACTORS), len(m)))
    R = np.eye(3)
    for i, factor in enumerate(_FACTORS):
        a, b = (_unit(rays * (1.0, 1.0, factor)) for rays in (m, n))
        # Wide first: the first fit starts from no rotation at all, the others from their neighbour.
        for scale_rad in (0.2, 40 * noise_rad, 4 * noise_rad):
            R = refine_rotation_compiled(R, a, b, scale_rad, iterations=4)
        lengths[i] = np.linalg.norm(b - a @ R.T, axis=1)
    # The median of a Rayleigh variable is 1.18 of its scale; a difference has the noise of two bearings.
    residuals = np.median(lengths, axis=1) / (np.sqrt(2 * np.log(2)) * np.sqrt(2))
    best = int(np.argmin(residuals))
    stated = int(np.argmin(np.abs(_FACTORS - 1)))
    variance = max(2 * float(residuals[best]) ** 2, 1e-24)
    costs = np.minimum(lengths[[stated, best]] ** 2 / variance, _GATE2)
    difference = costs[0] - costs[1]
    gain, scatter = float(difference.sum()), scatter_of_sum(difference, directions_of(m))
    return TurningCamera(
        focal_factor=float(_FACTORS[best]),
        residual_rad=float(residuals[best]),
        stated_residual_rad=float(residuals[stated]),
        matches=len(m),
        gain=gain,
        gain_z=gain / scatter if scatter > 0 else 0.0,
    )


def suspected_focal_factor(turning: TurningCamera, expected_rad: float) -> float | None:
    """The focal factor of a camera that seems to turn with a wrong calibration; None where there is no such suspicion.

    Parameters
    ----------
    turning : TurningCamera
        It is suspected where it explains the matches, the best rotation with the stated focal length leaves clearly
        more, and the best factor is not the last one tried: a plane's matches pull it beyond all bounds.
    expected_rad : float
        What a right model may leave: a standard deviation of a component of a bearing.
    """
    explains = turning.residual_rad <= expected_rad
    matters = turning.gain > _LEAST_GAIN and turning.gain_z > _LEAST_GAIN_Z
    off = abs(turning.focal_factor - 1) >= _LEAST_OFF - 1e-9
    found = _FACTORS[0] < turning.focal_factor < _FACTORS[-1]
    return turning.focal_factor if explains and matters and off and found else None


def _unit(rays: Floats) -> Floats:
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
