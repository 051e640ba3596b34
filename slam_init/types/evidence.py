"""Evidence: the figures behind a verdict, one type for each stage of an attempt.

The stages of :mod:`slam_init.attempt` fill these types, :class:`slam_init.types.result.Attempt` holds them, and
``summary.json`` and the recording are written from them. Figures that are compared with a threshold are gates
(:mod:`slam_init.types.gates`); figures that are only reported are here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from quest.relative_pose import PoseEvidence
from slam_init.types.comparison import Margin

__all__ = [
    "FreeEvidence",
    "MapEvidence",
    "PreviewEvidence",
    "RivalVote",
    "RotationOnlyEvidence",
    "TwoViewEvidence",
    "VoteEvidence",
    "WindowEvidence",
]

#: The figures behind the decision of a method of somebody else, under the method's own names. They are only reported.
FreeEvidence = Mapping[str, float | int | str]


@dataclass(frozen=True)
class PreviewEvidence:
    """Figures of the keyframe manager for the pair, before any epipolar geometry.

    Attributes
    ----------
    matches : int
        Tracks that both views see.
    motion_px : float
        90th percentile of the displacement of the tracks.
    rotation_deg : float
        Angle of the rotation that aligns the tracks best.
    parallax_px : float
        Median displacement after this rotation is removed.
    parallax_share : float
        Share of the tracks that are displaced by more than noise after the rotation is removed.
    spread : float
        Share of the image's grid cells that hold a common track, in [0, 1]; 0 if there are fewer than 3.
    """

    matches: int
    motion_px: float
    rotation_deg: float
    parallax_px: float
    parallax_share: float
    spread: float


@dataclass(frozen=True)
class TwoViewEvidence:
    """Figures of the relative pose of the pair.

    Attributes
    ----------
    statistics : PoseEvidence
        Counts and test values of :func:`quest.estimate_relative_pose`.
    kind : str or None
        ``general``, ``planar`` or ``rotation``. None where no pose was found; then all fields below are None too.
    alternatives : int or None
        Number of other motions that explain the matches as well.
    noise_px : float or None
        Standard deviation of a coordinate of a match, from the residuals.
    parallax_deg : float or None
        Median parallax of the inliers.
    direction_sigma_deg : float or None
        Standard deviation of the direction of the translation, from the noise of single matches.
    correlated_error_px : float or None
        Correlated tracking error of neighbouring tracks (:mod:`slam_init.decision.correlated_error`), not less than
        ``acceptance.min_correlated_error_px``.
    """

    statistics: PoseEvidence
    kind: str | None = None
    alternatives: int | None = None
    noise_px: float | None = None
    parallax_deg: float | None = None
    direction_sigma_deg: float | None = None
    correlated_error_px: float | None = None


@dataclass(frozen=True)
class RotationOnlyEvidence:
    """The best explanation of the matches by a camera that only rotates, with a free focal length.

    Attributes
    ----------
    focal_factor : float
        Focal length of that camera divided by the stated one.
    suspected_focal_factor : float or None
        The same factor if the stated focal length is suspected to be wrong: the rotation-only camera explains the
        matches, and the free focal length explains them clearly better than the stated one. Else None.
    """

    focal_factor: float
    suspected_focal_factor: float | None = None


@dataclass(frozen=True)
class RivalVote:
    """The vote of the tracks, as free points, between the best map and one rival.

    Attributes
    ----------
    rival : int
        Rank of the rival among the candidate maps, from 1; the best map has rank 0.
    log_likelihood : float
        Difference of the log likelihoods in nats; negative where the rival is better.
    z : float
        The same difference, in units of its standard deviation.
    """

    rival: int
    log_likelihood: float
    z: float


@dataclass(frozen=True)
class VoteEvidence:
    """The votes between the best map and its rivals.

    Attributes
    ----------
    rivals : tuple of RivalVote
        One vote for each rival; rivals that are the same map as the best one are left out.
    plane : Margin or None
        Vote on the first rival with the plane as a constraint (:mod:`slam_init.decision.plane_vote`); None where the
        scene is not planar or no further view sees the plane.
    deciding : Margin or None
        The vote that the verdict depends on: the vote on the rival over which the best map has the smallest advantage,
        negative if the rival is better. None if no rival had to be beaten.
    near_rival_deg : float
        Largest angle between the baselines of the best map and of a nearly equal rival that could not be ruled out. It
        is added to the bound of the direction error.
    """

    rivals: tuple[RivalVote, ...] = ()
    plane: Margin | None = None
    deciding: Margin | None = None
    near_rival_deg: float = 0.0


@dataclass(frozen=True)
class WindowEvidence:
    """The joint estimate of all views of the window, with the rule "window" (:mod:`slam_init.window.risk`).

    Attributes
    ----------
    views : int
        Number of views in the joint fit of the best hypothesis.
    hypotheses : int
        Number of different motions that were fitted.
    planar : bool
        Whether the points were held on a plane.
    risk : float
        Probability that the map is wrong; the sum of the four terms below.
    risk_direction, risk_rival, risk_rotation, risk_floor : float
        By the uncertainty of the direction, by another motion, by a camera that only rotates, and by what is not
        modelled.
    direction_sigma_deg, rotation_sigma_deg : float
        Largest standard deviations of the direction of the baseline and of the rotation of the pair.
    depth_sigma : float
        Median of the relative standard deviations of the depths.
    noise_px : float
        Measured standard deviation of a coordinate of a track.
    field_px : float
        Expected standard deviation of the coefficients of the smooth error that the tracks of a view share.
    rotation_log_likelihood : float
        Log likelihood of the best motion over a rotation-only camera, in nats.
    focal_factor : float
        Fitted focal length over the stated one.
    """

    views: int
    hypotheses: int
    planar: bool
    risk: float
    risk_direction: float
    risk_rival: float
    risk_rotation: float
    risk_floor: float
    direction_sigma_deg: float
    rotation_sigma_deg: float
    depth_sigma: float
    noise_px: float
    field_px: float
    rotation_log_likelihood: float
    focal_factor: float


@dataclass(frozen=True)
class MapEvidence:
    """Figures of the bundle adjustment of the best map.

    Attributes
    ----------
    reprojection_rmse_px : float or None
        Root mean square of the reprojection errors; None if the adjustment failed.
    failure : str or None
        Why bundle adjustment failed; None if it did not fail.
    """

    reprojection_rmse_px: float | None = None
    failure: str | None = None
