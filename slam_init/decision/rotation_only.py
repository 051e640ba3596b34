"""The explanation of a pair by a rotation-only camera: what establishes it, and a stated focal length that is wrong.

A short translation looks like a rotation as well: the views do not tell the two apart until one of them is long enough.
So a refusal says that the camera only rotates where the rotation has left its own evidence, else that there is not
enough translation yet.

If a camera rotates by R and its stated focal length is wrong by a factor s, its matches obey ``n ~ D R D^-1 m`` with
``D = diag(1, 1, s)``, in bearings under the stated calibration. The relation is exact for a pinhole camera; for a
fisheye camera it holds near the optical axis only. It is a homography with four unknowns. An estimator that trusts the
calibration takes it for a plane and a translation, with every point in front of both cameras. A real translation does
not have this form, unless it is too small to be distinguished from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from quest.noise import GATE_SIGMAS
from quest.robust.rotation import refine_rotation
from quest.robust.spatial_blocks import directions_of, scatter_of_sum
from slam_init.config import Config
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.evidence import RotationOnlyEvidence
from slam_init.types.lens_in_use import CALIBRATED_SIGMA
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt
from slam_init.window.levels import EVEN_ODDS

#: Focal factors that are tried. Focal lengths from memory or from a data sheet are wrong by up to a tenth.
#: Class: assumption.
_FACTORS = np.linspace(0.9, 1.1, 21)
#: A focal length is suspected only if it is wrong by two hundredths or more, twice the error of a careless calibration.
_LEAST_OFF = CALIBRATED_SIGMA
#: Required gain by the free focal length: chi-square with one degree of freedom, exceeded by chance once in 15 000
#: cases. Over regions of the image it has to exceed the gate too, so that a body that moves by itself cannot decide.
#: Class: level, in chi-square.
_LEAST_GAIN = 16.0
#: A rotation moves tracks farther across the lens than a short translation does, and the remaining error of the lens
#: calibration grows with the displacement. A lens that is calibrated to half a pixel leaves three times the correlated
#: error of a translation.
#: Class: assumption.
_CORRELATED_FACTOR = 3.0
#: Correlated tracking error of a translation, which does not average out: three times the 0.05 px by which
#: interpolation between pixels misleads a tracker.
#: Class: assumption.
_CORRELATED_PX = 0.15


#: A translation along a frontal wall moves the tracks nearly as a rotation does. The median of what the best rotation
#: leaves of it is this share of r^2 of its displacement, with r half the diagonal of the image over the focal length:
#: .12 to .27 over fields of view of 30 to 90 degrees and all directions. Any other scene leaves more.
#: Class: geometry.
_LEFT_OF_A_WALL = 0.2
#: A rotation is established where what it leaves allows such a translation this share of the displacement at the most.
#: Two panoramas have .02 to .17 with a right lens and with an estimated one. Films that move have .39 and more where
#: a rotation explains their tracks still: a desk .8, a board .45, a drawn room .4 (Tsukuba).
#: Class: measured.
_ESTABLISHED = 0.25
_NOT_YET = "not enough translation yet: keep translating, best sideways"


@dataclass(frozen=True)
class RotationOnlyCamera:
    """The best pure rotation with a free focal length."""

    #: The true focal length over the stated one.
    focal_factor: float
    #: Standard deviation of a component of a bearing that the fit leaves, by the median over the matches. For a
    #: camera that really only rotates this is the noise.
    residual_rad: float
    #: Number of matches of the medians.
    matches: int
    #: gain, gain_z: Decrease of the squared residuals by the free focal length, in units of their variance, and in
    #: units of the standard deviation of that sum over regions of the image.
    gain: float
    gain_z: float

    @property
    def chance_factor(self) -> float:
        """Bound of a residual divided by its expectation; chance exceeds the bound once in 30 000 cases.

        The median of N lengths with two Gaussian components each has a relative standard deviation of 0.72 / sqrt(N).
        """
        return 1 + 4 * 0.72 / float(np.sqrt(max(self.matches, 1)))


def with_established_reason(camera: Camera, config: Config, attempt: Attempt) -> Attempt:
    """A refusal as a pure rotation, with another reason where its evidence does not establish the rotation."""
    if attempt.verdict is not Verdict.PURE_ROTATION or _is_established(camera, attempt):
        return attempt
    reason, advice = Verdict.LOW_PARALLAX, _NOT_YET
    # Tracks as noisy as an outlier follow no motion, and no rotation either.
    if attempt.window is not None and attempt.window.noise_px > config.two_view.threshold_px:
        reason, advice = Verdict.NO_CONSISTENT_MOTION, Verdict.NO_CONSISTENT_MOTION.advice
    gates = (
        replace(gate, reason=reason, advice=advice) if gate.reason is Verdict.PURE_ROTATION else gate
        for gate in attempt.gates
    )
    return replace(attempt, verdict=reason, advice=advice, gates=tuple(gates))


def _is_established(camera: Camera, attempt: Attempt) -> bool:
    """Whether a rotation explains the tracks, and what it leaves allows no translation of a good share of it."""
    preview, window = attempt.preview, attempt.window
    if preview is None or (window is not None and window.risk_rotation <= EVEN_ODDS):
        return False
    radius2 = min(((camera.width / 2) ** 2 + (camera.height / 2) ** 2) / camera.focal_px**2, 1.0)
    rotation_px = math.radians(preview.rotation_deg) * camera.focal_px
    return preview.parallax_px < _ESTABLISHED * _LEFT_OF_A_WALL * radius2 * rotation_px


def fit_rotation_only(rays1: Floats, rays2: Floats, noise_rad: float) -> RotationOnlyCamera:
    """Fit a rotation and a focal factor to matches.

    Shapes: ``rays1, rays2`` (N, 3).

    * ``noise_rad``: Approximate standard deviation of a component of a bearing: the scale down to which the fit is
      robust.
    """
    m, n = rays1, rays2
    lengths = np.empty((len(_FACTORS), len(m)))
    R = np.eye(3)
    for i, factor in enumerate(_FACTORS):
        a, b = (_unit(rays * (1.0, 1.0, factor)) for rays in (m, n))
        # The scale begins wide: the first factor starts from no rotation, each other factor from the rotation before.
        for scale_rad in (0.2, 40 * noise_rad, 4 * noise_rad):
            R = refine_rotation(R, a, b, scale_rad, iterations=4)
        lengths[i] = np.linalg.norm(b - a @ R.T, axis=1)
    # The median of a Rayleigh variable is 1.18 of its scale; a difference has the noise of two bearings.
    residuals = np.median(lengths, axis=1) / (np.sqrt(2 * np.log(2)) * np.sqrt(2))
    best = int(np.argmin(residuals))
    stated = int(np.argmin(np.abs(_FACTORS - 1)))
    variance = max(2 * float(residuals[best]) ** 2, 1e-24)
    # Squared residuals are truncated at the gate in each of their two components.
    costs = np.minimum(lengths[[stated, best]] ** 2 / variance, 2 * GATE_SIGMAS**2)
    difference = costs[0] - costs[1]
    gain, scatter = float(difference.sum()), scatter_of_sum(difference, directions_of(m))
    return RotationOnlyCamera(
        focal_factor=float(_FACTORS[best]),
        residual_rad=float(residuals[best]),
        matches=len(m),
        gain=gain,
        gain_z=gain / scatter if scatter > 0 else 0.0,
    )


def suspected_focal_factor(rotation_only: RotationOnlyCamera, expected_rad: float) -> float | None:
    """Return the focal factor of a camera that seems to be rotation-only, with a wrong calibration.

    * ``expected_rad``: Largest residual of a right model: a standard deviation of a component of a bearing.
    * Returns: None where the calibration is not suspected. It is suspected if the rotation-only camera explains the
      matches, if the stated focal length explains them clearly less well, and if the best factor is not the first or
      the last one that was tried (the matches of a plane pull the factor beyond all bounds).
    """
    explains = rotation_only.residual_rad <= expected_rad
    matters = rotation_only.gain > _LEAST_GAIN and rotation_only.gain_z > GATE_SIGMAS
    off = abs(rotation_only.focal_factor - 1) >= _LEAST_OFF - 1e-9
    inside = _FACTORS[0] < rotation_only.focal_factor < _FACTORS[-1]
    return rotation_only.focal_factor if explains and matters and off and inside else None


def rotation_only_evidence(
    camera: Camera, config: Config, rotation_only: RotationOnlyCamera, noise_rad: float
) -> RotationOnlyEvidence:
    """Return the focal length of the rotation-only camera, and whether the stated one is suspected to be wrong."""
    expected_rad = _expected_rad(camera, config, rotation_only, noise_rad)
    return RotationOnlyEvidence(rotation_only.focal_factor, suspected_focal_factor(rotation_only, expected_rad))


def _expected_rad(camera: Camera, config: Config, rotation_only: RotationOnlyCamera, noise_rad: float) -> float:
    """Return the largest residual of a camera that really only rotates: noise, correlated error, and chance."""
    noise_rad = max(noise_rad, config.map.min_noise_px / camera.focal_px)
    correlated_rad = _CORRELATED_PX / camera.focal_px
    return rotation_only.chance_factor * float(np.hypot(noise_rad, _CORRELATED_FACTOR * correlated_rad))


def _unit(rays: Floats) -> Floats:
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
