"""The views of a window, and what follows once it is evaluated: gates, reason, the next lens, and the evidence.

All of it is a function of the window. Nothing here looks at the history or remembers an earlier window.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quest.geometry.epipolar import depths_from_pose
from quest.noise import GATE_SIGMAS
from slam_init.decision.current_pose import WindowMotion
from slam_init.decision.lens import advice_on, followed
from slam_init.decision.two_views import MatchedPair
from slam_init.frontend.static_tracks import static_tracks, without
from slam_init.types.arrays import Bools, Floats
from slam_init.types.evidence import WindowEvidence
from slam_init.types.frame import Observations
from slam_init.types.lens import MAX_FOCAL_SIGMA, CurrentLens
from slam_init.types.pose import Pose
from slam_init.types.refusal import Gate, GateName, Verdict, at_most
from slam_init.types.result import Attempt
from slam_init.window.hypotheses import OverlayTracks, WindowHypotheses
from slam_init.window.levels import EVEN_ODDS, FLOOR, UNDECIDED
from slam_init.window.motion import FittedMotion
from slam_init.window.risk import WindowRisk
from slam_init.window.uncertainty import suspected_k1

_LENS_MAY_CHANGE = (
    "the tracks do not distinguish this motion from a lens that focuses, or from images that are stabilized: translate "
    "further, best sideways, or set acceptance.lens_changes to 0 if focus and image are fixed"
)
_CHANCE = "the matches scatter by {:.0f} px about any motion: the images are noise, or show different scenes"
#: Matches that scatter by more are matches by chance: those of images of noise scatter by 3 to 11 px, those of real
#: sequences by 0.1 to 0.2.
#: Class: measured.
_CHANCE_PX = 2.5


def off_plane(pose: Pose, rays1: Floats, rays2: Floats) -> Floats:
    """Angles (N,) between the rays of the second view and the epipolar planes of those of the first."""
    normals = np.cross(pose.t, rays1 @ pose.R.T)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return np.asarray(np.abs(np.einsum("ij,ij->i", rays2, normals)))


@dataclass(frozen=True, eq=False)
class WindowViews:
    """The pair of a window and its further views, without the tracks that lie on the image and not in the scene."""

    pair: MatchedPair
    further: Sequence[Observations]
    #: The tracks that were left out; None without them.
    overlay: OverlayTracks | None = None

    @staticmethod
    def of(pair: MatchedPair, further: Sequence[Observations]) -> WindowViews:
        """Leave out the tracks that stay at their pixels in all views while the others move."""
        static = static_tracks(pair.reference, pair.current, further)
        if not len(static):
            return WindowViews(pair, further)
        stays = np.isin(pair.track_ids, static)
        overlay = OverlayTracks(pair.track_ids[stays], pair.rays1[stays], float(stays.mean()))
        reference, current, *others = (without(view, static) for view in (pair.reference, pair.current, *further))
        return WindowViews(MatchedPair(pair.preview, reference, current), others, overlay)

    @property
    def all(self) -> tuple[Observations, ...]:
        """Reference and current first."""
        return (self.pair.reference, self.pair.current, *self.further)


@dataclass(frozen=True, eq=False)
class EvaluatedWindow:
    """A window: its pair, its hypotheses and the risk of the best one."""

    pair: MatchedPair
    hypotheses: WindowHypotheses
    risk: WindowRisk
    #: The lens through which the rays of the pair were computed.
    lens: CurrentLens
    #: A match is an outlier if it is farther from its projection.
    threshold_rad: float

    @property
    def best(self) -> FittedMotion:
        """The best hypothesis."""
        return self.hypotheses.motions[0]

    @property
    def only_rotates(self) -> bool:
        """Whether the camera merely rotates."""
        return self.risk.rotation > EVEN_ODDS

    @property
    def motion(self) -> WindowMotion:
        """The poses of its cameras: those of the best motion, or of the camera that only rotates."""
        poses = self.best.motion.cam_from_world
        if self.only_rotates:
            R = self.hypotheses.rotation_only.state.R
            poses = {frame: Pose(R[k], np.zeros(3)) for k, frame in enumerate(self.hypotheses.tracks.frames)}
        pair, directions = (self.best.frames[0], self.best.frames[1]), self.risk.directions
        differences_deg = [self.best.difference_deg(one) for one in self.hypotheses.motions[1:]]
        # A competing motion may be right.
        rotation_deg, direction_deg = math.sqrt(self.risk.competing) * np.max([(0.0, 0.0), *differences_deg], axis=0)
        sigmas_deg = (
            math.hypot(directions.rotation_sigma_deg, rotation_deg),
            math.hypot(directions.sigma_deg, direction_deg),
        )
        return WindowMotion(poses, pair, self.only_rotates, *sigmas_deg)

    @property
    def next_lens(self) -> CurrentLens:
        """The lens to go on with where no map is accepted."""
        return followed(self.lens, self.risk.lens.mean)

    @property
    def lens_of_best(self) -> CurrentLens:
        """The lens that was fitted with the best motion; a calibration stays."""
        state = self.best.fit.state
        return self.lens.moved(state.lens.log_scale, state.lens.k1) if self.lens.is_unknown else self.lens

    def certain_frames(self, most: float) -> tuple[int, ...]:
        """Reference, current, and the views whose own directions are at most as risky: the keyframes of the map."""
        reference, current, *others = self.best.frames
        risks = zip(others, self.risk.directions.of_views[1:], strict=True)
        return (reference, current, *(frame for frame, one in risks if one <= most))

    def gates(self, max_risk: float) -> list[Gate]:
        """The gates on the risk and, where the focal length is estimated, on its deviation."""
        reason, advice = self._reason(max_risk)
        if not self.lens.is_unknown:
            return [at_most(GateName.RISK, self.risk.total, max_risk, reason, advice)]
        lens_advice, unknown = advice_on(self.lens, self.focal_sigma), Verdict.UNKNOWN_FOCAL_LENGTH
        if self._held_by_lens(reason, max_risk):
            reason, advice = unknown, lens_advice
        return [
            at_most(GateName.RISK, self.risk.total, max_risk, reason, advice),
            at_most(GateName.FOCAL_SIGMA, self.focal_sigma, MAX_FOCAL_SIGMA, unknown, lens_advice),
        ]

    def with_evidence(self, attempt: Attempt) -> Attempt:
        """Add what the window found to its attempt: figures, inliers, and tracks with a motion of their own."""
        moving = np.isin(self.pair.track_ids, self.risk.other.track_ids)
        return replace(attempt, window=self._evidence(), inliers=self._inliers(), moving=moving)

    def _evidence(self) -> WindowEvidence:
        hypotheses, risk, lens, found = self.hypotheses, self.risk, self.lens, self.risk.lens
        rolling = lens.camera.with_readout(found.mean.readout_s) if found.readout_sigma_s > 0 else None
        return WindowEvidence(
            views=len(self.best.rows),
            hypotheses=len(hypotheses.motions),
            planar=hypotheses.planar,
            risk=risk.total,
            risk_direction=risk.direction,
            risk_competing=risk.competing,
            risk_rotation=risk.rotation,
            risk_moving=risk.moving,
            risk_floor=FLOOR,
            direction_sigma_deg=risk.directions.sigma_deg,
            rotation_sigma_deg=risk.directions.rotation_sigma_deg,
            depth_sigma=risk.depth_sigma,
            noise_px=hypotheses.tracks.noise_px,
            correlated_px=risk.correlated_px,
            rotation_log_likelihood=risk.rotation_log_likelihood,
            focal_factor=math.exp(lens.log_scale + found.mean.log_scale),
            focal_sigma=found.focal_sigma,
            readout_ms=None if rolling is None else rolling.readout_ms,
            readout_direction=None if rolling is None else rolling.readout_direction,
            readout_sigma_ms=None if rolling is None else 1e3 * found.readout_sigma_s,
            distortion_k1=lens.k1 + found.mean.k1,
            distortion_sigma=found.k1_sigma,
            suspected_distortion=None if lens.is_unknown else suspected_k1(found),
        )

    def _inliers(self) -> Bools:
        """The matches that the best motion explains, through its lens and with points in front of both cameras."""
        pair, pose, lens = self.pair, self.best.cam2_from_cam1, self.lens_of_best
        m, n = pair.rays1, pair.rays2
        if lens is not self.lens:
            m, n = lens.camera.bearings(pair.pixels1), lens.camera.bearings(pair.pixels2)
        depths1, depths2 = depths_from_pose(pose.R, pose.t, m, n)
        near = off_plane(pose, m, n) < np.sqrt(2) * self.threshold_rad
        return np.asarray(near & (depths1 > 0) & (depths2 > 0))

    @property
    def focal_sigma(self) -> float:
        """The deviation of the focal length by the window, and by a stated one that it agrees with.

        The deviation by the window has a factor for errors that its tracks share. The earlier estimate has its own.
        """
        found, stated = self.risk.lens, self.lens.stated
        if stated.focal_sigma is None or stated.source in ("prior", "metadata"):
            return found.focal_sigma
        if abs(self.lens.log_scale + found.mean.log_scale) > GATE_SIGMAS * stated.focal_sigma:
            return found.focal_sigma
        # An estimate by the frames that are read again knows the window already.
        return stated.focal_sigma if stated.source == "estimated" else min(found.focal_sigma, stated.focal_sigma)

    def _held_by_lens(self, reason: Verdict, max_risk: float) -> bool:
        """Whether the direction would be known well enough if the focal length were."""
        risk = self.risk
        by_direction = reason in (Verdict.LOW_PARALLAX, Verdict.MOVING_OBJECTS) and risk.direction >= risk.competing
        wide = self.focal_sigma > MAX_FOCAL_SIGMA
        return by_direction and wide and risk.directions.with_known_lens <= max_risk

    def _reason(self, max_risk: float) -> tuple[Verdict, str | None]:
        """The verdict and the advice: no translation if it is not significant, else the largest term of the risk."""
        planar, risk = self.hypotheses.planar, self.risk
        # A rotation with a wrong focal length looks like a plane with two motions: then neither motion may be right. So
        # an ambiguous plane is the reason only where the risk of a rotation alone would be accepted.
        largest = max_risk if planar and risk.competing >= risk.direction else UNDECIDED
        if risk.rotation > largest or risk.rotation >= max(risk.competing, risk.direction):
            noise_px = self.hypotheses.tracks.noise_px
            if noise_px > _CHANCE_PX:
                return Verdict.NO_CONSISTENT_MOTION, _CHANCE.format(noise_px)
            return Verdict.PURE_ROTATION, None
        if risk.moving >= max(risk.competing, risk.directions.if_rigid):
            return Verdict.MOVING_OBJECTS, None
        if risk.competing >= risk.direction:
            if planar:
                return Verdict.AMBIGUOUS_PLANE, None
            return Verdict.LOW_PARALLAX, "two motions explain the tracks: translate further, best sideways"
        if risk.directions.if_lens_fixed <= max_risk:
            return Verdict.LOW_PARALLAX, _LENS_MAY_CHANGE
        if not self.lens.is_unknown and risk.directions.if_lens_right <= max_risk:
            return Verdict.LOW_PARALLAX, None
        # A rigid scene with these tracks would be known well enough.
        return (Verdict.LOW_PARALLAX if risk.directions.if_rigid > max_risk else Verdict.MOVING_OBJECTS), None
