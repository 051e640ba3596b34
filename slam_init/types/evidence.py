"""Evidence: the figures behind a verdict, one type for each stage of an attempt.

The stages of :mod:`slam_init.decision` fill these types, :class:`slam_init.types.result.Attempt` holds them, and
``summary.json`` and the recording are written from them. Figures that are compared with a threshold are gates
(:mod:`slam_init.types.refusal`); figures that are only reported are here. :class:`Margin` is that of a vote between
two maps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from quest.relative_pose import PoseEvidence

#: The figures behind the decision of a third-party method, under the method's own names. They are only reported.
FreeEvidence = Mapping[str, float | int | str]


@dataclass(frozen=True)
class PreviewEvidence:
    """Figures of the keyframe manager for the pair, before any epipolar geometry."""

    #: Tracks that both views see.
    matches: int
    #: 90th percentile of the displacement of the tracks.
    motion_px: float
    #: Angle of the rotation that aligns the tracks best.
    rotation_deg: float
    #: Median displacement after this rotation is removed.
    parallax_px: float
    #: Share of the tracks that are displaced by more than noise after the rotation is removed.
    parallax_share: float
    #: Share of the image's grid cells that hold a common track, in [0, 1]; 0 if there are fewer than 3.
    spread: float


@dataclass(frozen=True)
class TwoViewEvidence:
    """Figures of the relative pose of the pair."""

    #: Counts and test values of :func:`quest.estimate_relative_pose`.
    statistics: PoseEvidence
    #: ``general``, ``planar`` or ``rotation``. None where no pose was found; then all fields below are None too.
    kind: str | None = None
    #: Number of other motions that explain the matches as well.
    alternatives: int | None = None
    #: Standard deviation of a coordinate of a match, from the residuals.
    noise_px: float | None = None
    #: Median parallax of the inliers.
    parallax_deg: float | None = None
    #: Standard deviation of the direction of the translation, from the noise of single matches.
    direction_sigma_deg: float | None = None


@dataclass(frozen=True)
class FreeFocal:
    """The focal length by the tracks of a window alone."""

    #: stated_px, estimated_px: The stated focal length and that of the tracks.
    stated_px: float
    estimated_px: float
    #: Standard deviation of the estimate.
    sigma_px: float
    #: Whether both differ by more than chance.
    contradicts: bool

    @property
    def factor(self) -> float:
        """The estimated focal length over the stated one."""
        return self.estimated_px / self.stated_px

    def enlarged(self, factor: float) -> FreeFocal:
        """The same for images of another size."""
        return FreeFocal(factor * self.stated_px, factor * self.estimated_px, factor * self.sigma_px, self.contradicts)

    @property
    def note(self) -> str:
        """The note for the user where both contradict one another."""
        estimate = f"{self.estimated_px:.0f} +- {self.sigma_px:.0f}"
        return f"stated f = {self.stated_px:.0f} does not fit these tracks; free estimate {estimate}: check --camera"


@dataclass(frozen=True)
class WindowEvidence:
    """The joint estimate of all views of the window (:mod:`slam_init.window.risk`).

    Attributes
    ----------
    views : int
        Number of views in the joint fit of the best hypothesis.
    hypotheses : int
        Number of different motions that were fitted.
    planar : bool
        Whether the points were held on a plane.
    risk : float
        Probability that the map is wrong; the sum of the five terms below, at most 1.
    risk_direction, risk_competing, risk_rotation, risk_moving, risk_floor : float
        By the uncertainty of direction and rotation, by a competing motion, by a camera that only rotates, by moving
        objects (tracks with a rigid motion of their own), and by what is not modelled.
    direction_sigma_deg, rotation_sigma_deg : float
        Largest standard deviations of the direction of the baseline and of the rotation of the pair.
    depth_sigma : float
        Median of the relative standard deviations of the depths of the tracks that the best motion explains. The
        landmarks of the map have a figure of their own in the summary.
    noise_px : float
        Measured standard deviation of a coordinate of a track.
    correlated_px : float
        Expected standard deviation of the coefficients of the smooth error that the tracks of a view share.
    rotation_log_likelihood : float
        Log likelihood of the best motion over a rotation-only camera, in nats.
    focal_factor : float
        Fitted focal length over the stated one.
    focal_sigma : float
        Relative standard deviation of the fitted focal length.
    readout_ms : float or None
        Estimated time from the first to the last row of a rolling shutter. None where it is known or where the turning
        of the camera is not, as in photographs; then the two fields below are None too.
    readout_direction : str or None
        ``down``, ``up``, ``right`` or ``left``.
    readout_sigma_ms : float or None
        Standard deviation of the estimate.
    distortion_k1, distortion_sigma : float
        What the fit adds to the first coefficient of the radial distortion of the stated camera, and its standard
        deviation.
    suspected_distortion : float or None
        ``distortion_k1`` where the stated distortion is suspected to be wrong, else None.
    """

    views: int
    hypotheses: int
    planar: bool
    risk: float
    risk_direction: float
    risk_competing: float
    risk_rotation: float
    risk_moving: float
    risk_floor: float
    direction_sigma_deg: float
    rotation_sigma_deg: float
    depth_sigma: float
    noise_px: float
    correlated_px: float
    rotation_log_likelihood: float
    focal_factor: float
    focal_sigma: float
    readout_ms: float | None = None
    readout_direction: str | None = None
    readout_sigma_ms: float | None = None
    distortion_k1: float = 0.0
    distortion_sigma: float = 0.0
    suspected_distortion: float | None = None


@dataclass(frozen=True)
class MapEvidence:
    """Figures of the bundle adjustment of the map."""

    #: Root mean square of the reprojection errors; None if the adjustment failed.
    reprojection_rmse_px: float | None = None
    #: Why bundle adjustment failed; None if it did not fail.
    failure: str | None = None
    #: Whether the graph has priors on the poses, by the joint estimate of all views. They are added where the landmarks
    #: alone would move the motion away from that estimate.
    pose_prior: bool = False


@dataclass(frozen=True)
class Margin:
    """The amount by which one map explains the tracks better than another."""

    #: Smallest log likelihood that decides the vote, also if the assumed noise is wrong by a factor of two.
    LOG_LIKELIHOOD_NEEDED: ClassVar[float] = 20.0

    #: Difference of the truncated Gaussian log likelihoods, in nats; positive where the first map is better.
    log_likelihood: float
    #: The same difference, in units of its standard deviation if both maps explain the tracks equally well (after Vuong
    #: 1989). Each track votes by the difference of its two log likelihoods; the votes against the first map give the
    #: standard deviation (:mod:`slam_init.window.competing`).
    z: float
    #: Smallest z that decides the vote. Two equally good maps exceed the default once in 30 000 cases.
    z_needed: float = 4.0

    def in_words(self, first: str, second: str) -> str:
        """Say which of two maps the tracks prefer, by their names: ``prefer A by 3.0 nats``."""
        preferred = first if self.log_likelihood >= 0 else second
        return f"prefer {preferred} by {abs(self.log_likelihood):.1f} nats"

    def decides(self) -> bool:
        """Return whether the first map is significantly better.

        * Returns: True if both z and the log likelihood reach their required values.
        """
        return self.decision_ratio() >= 1

    def decision_ratio(self) -> float:
        """Divide z and the log likelihood by their required values.

        * Returns: The smaller one of the two ratios; the vote decides from 1 on.
        """
        return min(self.z / self.z_needed, self.log_likelihood / self.LOG_LIKELIHOOD_NEEDED)
