"""The decision on a frame: by the risk that the map of the best hypothesis is wrong, and by the depths of this map.

quest proposes motions from the pairs that the keyframe manager chooses. From then on the motions live: each further
frame joins their joint fit, and the risk is stated anew. A map is built for an accepted motion, for both motions of an
undecided plane, or on request.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import NoPose, RelativePose
from quest.geometry.epipolar import depths_from_pose
from slam_init.bundle.problem import BundleFailure, BundleSolution, PosePrior
from slam_init.config import Config
from slam_init.decision.depths import depth_gates
from slam_init.decision.lens import MAX_FOCAL_SIGMA, WindowLens
from slam_init.decision.outcome import Outcome
from slam_init.decision.pose_so_far import WindowMotion
from slam_init.decision.refusal import refused_at, refused_by, with_gates
from slam_init.decision.screening import LEAST_PARALLAX_SHARE, preview_evidence
from slam_init.decision.two_views import (
    MatchedPair,
    Proposer,
    judge_rotation,
    match_pair,
    pose_at_fitting_threshold,
    pose_evidence,
)
from slam_init.decision.window_evidence import rotation_evidence, window_evidence
from slam_init.frontend.keyframes import PairPreview
from slam_init.frontend.rolling_shutter import RollingShutter
from slam_init.frontend.static_tracks import static_tracks, without
from slam_init.frontend.tracks import History
from slam_init.mapping.candidate import map_of_poses
from slam_init.mapping.map_building import MapWithViews, map_with_views
from slam_init.mapping.views import TrackTable, table_of, voting_views
from slam_init.types.arrays import Bools
from slam_init.types.camera import Camera
from slam_init.types.evidence import MapEvidence
from slam_init.types.frame import Observations
from slam_init.types.gates import GateName, Stage, at_least, at_most
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt, ProvisionalMap
from slam_init.types.stopwatch import Stopwatch
from slam_init.window.hypotheses import WindowHypotheses
from slam_init.window.levels import MERE_ROTATION
from slam_init.window.live import LiveHypotheses
from slam_init.window.motion import FittedMotion, difference_deg
from slam_init.window.risk import WindowRisk, confirmed, risk_of
from slam_init.window.state import CALIBRATED_SIGMA
from slam_init.window.tracks import MAX_VIEWS

#: Standard deviation of an unknown readout about none: global shutters have none, and rolling ones take up to the time
#: between two frames of a video, which is two standard deviations.
_READOUT_SIGMA_S = 1 / 60
#: A gain over the rotation-only camera that chance exceeds more often than this is no evidence of a translation. A
#: direction without a translation is uncertain too, so that its term would hide the cause.
_INSIGNIFICANT = 0.05
#: A calibration is left where the focal length is off by so many of its standard deviations: once in 400 by chance.
_CERTAIN_FOCAL_SIGMAS = 3.0
#: Largest risk that a further keyframe adds: a tenth of the largest risk that is accepted.
_RISK_OF_A_VIEW = 5e-4
#: Bundle adjustment on all tracks may turn the fitted motion by as much as a third of what makes a map wrong.
_ADJUSTED_ROTATION_DEG, _ADJUSTED_DIRECTION_DEG = 1.5, 5.0


@dataclass(frozen=True, eq=False)
class _Judged:
    """The last window: its pair, its hypotheses and its risk."""

    pair: MatchedPair
    hypotheses: WindowHypotheses
    risk: WindowRisk
    attempt: Attempt


class WindowRule:
    """Judges the frames of a video by the joint estimate of their window.

    * ``history``: Holds the candidate references and the frames between them.
    * ``shutter``: Corrects the rays of the history; the window estimates an unknown readout. By default one that knows
      no turning.
    * ``third_view``: Whether further views join the window. Without them the window holds reference and current alone.
    * ``propose``: Estimates the relative pose of a chosen pair; by default quest does.
    """

    def __init__(
        self,
        camera: Camera,
        config: Config,
        history: History,
        shutter: RollingShutter | None = None,
        *,
        third_view: bool = True,
        propose: Proposer | None = None,
    ) -> None:
        self.lens = WindowLens(camera)
        self._config = config
        self._history = history
        self._shutter = shutter or RollingShutter(camera)
        self._third_view = third_view
        self._estimate = propose or pose_at_fitting_threshold
        readout_sigma_s = _READOUT_SIGMA_S if camera.readout_s is None else 0.0
        self._readout_sigma_s = readout_sigma_s
        self._live = LiveHypotheses(camera, self.lens.priors(readout_sigma_s), config.map.min_noise_px)
        self._threshold_rad = config.two_view.threshold_px / camera.focal_px
        self._reference: int | None = None
        self._last: _Judged | None = None
        self._rotating = False
        self._static = np.zeros(0, np.int64)
        self._further: list[Observations] = []
        self._lens_step = (0.0, 0.0)

    def judge(
        self,
        chosen: PairPreview | None,
        pairs: Sequence[PairPreview],
        current: Observations,
        stopwatch: Stopwatch,
    ) -> Outcome | None:
        """Judge a frame.

        * ``chosen``: The pair that quest proposes new motions from; None where no pair is worth it.
        * Returns: None where no pair was chosen, and no motion is known or the window holds the pair alone.
        """
        preview = chosen or next((pair for pair in pairs if pair.reference == self._reference), None)
        # Without further views, an earlier motion has only the reference in common with the window.
        lives_on = bool(self._live) and self._third_view
        if preview is None or not (chosen or lives_on):
            return None
        pair = self._matched(preview, current)
        attempt = Attempt(
            frames=(preview.reference, preview.current),
            verdict=Verdict.ACCEPTED,
            pixels1=pair.pixels1,
            pixels2=pair.pixels2,
            inliers=np.zeros(len(pair.rays1), bool),
            moving=np.zeros(len(pair.rays1), bool),
            preview=preview_evidence(preview),
        )
        if self._rotating and all(one.parallax_share < LEAST_PARALLAX_SHARE for one in pairs):
            # The joint fit of a rotation-only camera takes the most steps, and no pair tells anything new.
            return Outcome(refused_at(attempt, Verdict.PURE_ROTATION, Stage.MOTION))
        if chosen is not None:
            self._reference = chosen.reference
        if chosen is not None and (self._live.wants_proposals() or not self._third_view):
            with stopwatch("two_view"):
                pose, self._threshold_rad = self._estimate(self.lens.camera, self._config, pair)
            attempt = self._with_pose(attempt, pose)
            if isinstance(pose, RelativePose):
                self._propose(pair, pose)
            if not self._live:
                self._last = None
                return Outcome(self._without_motion(attempt, pose))
        with stopwatch("map"):
            return self._judged(attempt, pair)

    def provisional(self) -> ProvisionalMap | None:
        """Build the map of the best motion of the last window.

        * Returns: None where there is no motion, where its map cannot be built, or where the history has dropped its
          frames. The risk is 1 where bundle adjustment moved the map away from the motion.
        """
        last = self._last
        if last is None or any(frame not in self._history for frame in last.hypotheses.motions[0].frames):
            return None
        frames = _certain_frames(last.hypotheses, last.risk, last.risk.total)
        bundle, _ = self._agreeing_map(last, frames)
        if not isinstance(bundle, BundleSolution):
            return None
        risk = 1.0 if _moved_frames(bundle, last.hypotheses.motions[0]) else last.risk.total
        built = self._built(bundle, last.hypotheses, risk)
        return None if built is None else ProvisionalMap(built.map, risk)

    def newest_motion(self) -> WindowMotion | None:
        """What the last window says of its cameras; None where the last judgement had none."""
        if self._last is None:
            return None
        hypotheses, risk = self._last.hypotheses, self._last.risk
        best = hypotheses.motions[0]
        rotates_only, poses = risk.rotation > MERE_ROTATION, best.motion.cam_from_world
        if rotates_only:
            R = hypotheses.rotation_only.state.R
            poses = {frame: Pose(R[k], np.zeros(3)) for k, frame in enumerate(hypotheses.tracks.frames)}
        pair = (best.frames[0], best.frames[1])
        return WindowMotion(poses, pair, rotates_only, risk.rotation_sigma_deg, risk.direction_sigma_deg)

    def follow_lens(self) -> bool:
        """Take the lens that the last judgement found, where the stated focal length is no calibration.

        The rays of the history become those of this lens.
        """
        log_scale, k1 = self._lens_step
        if log_scale == k1 == 0.0:
            return False
        self._lens_step = (0.0, 0.0)
        self.lens.follow(log_scale, k1)
        self._live.adopt_lens(self.lens.camera, self.lens.priors(self._readout_sigma_s), log_scale, k1)
        self._shutter.adopt_camera(self._history, self.lens.camera)
        self._last = None
        return True

    # -- parts of the judgement -------------------------------------------------------------------

    def _with_pose(self, attempt: Attempt, pose: RelativePose | NoPose) -> Attempt:
        evidence = pose_evidence(self.lens.camera, pose)
        inliers = pose.inliers if isinstance(pose, RelativePose) else attempt.inliers
        return replace(attempt, two_view=evidence, inliers=inliers)

    def _propose(self, pair: MatchedPair, pose: RelativePose) -> None:
        noise_px = max(self._config.map.min_noise_px, pose.noise_rad * self.lens.camera.focal_px)
        frames = (pair.preview.reference, pair.preview.current)
        self._live.propose(pose, frames, pair.rays1, pair.rays2, noise_px, self._shutter.readout_s)

    def _without_motion(self, attempt: Attempt, pose: RelativePose | NoPose) -> Attempt:
        if isinstance(pose, NoPose):
            return refused_at(attempt, Verdict(pose.reason), Stage.TWO_VIEWS)
        return judge_rotation(self.lens.camera, self._config, attempt, pose)

    def _judged(self, attempt: Attempt, pair: MatchedPair) -> Outcome:
        try:
            views = [pair.reference, pair.current]
            views += [without(view, self._static) for view in self._further]
            hypotheses = self._live.fitted(views, [self._history.attitude(view.frame) for view in views])
            risk = None
            if hypotheses is not None:
                hypotheses, risk = self._confirmed(hypotheses)
        except np.linalg.LinAlgError as error:
            # A degenerate window: its motions must not be the start of the next one.
            self._live.forget()
            hypotheses = risk = None
            attempt = replace(attempt, map=MapEvidence(failure=f"the window has no solution: {error}"))
        if hypotheses is None or risk is None:
            self._last = None
            return Outcome(refused_at(attempt, Verdict.NO_CONSISTENT_MOTION, Stage.MAP))
        pair = self._with_readout(pair, risk)
        attempt = replace(
            attempt,
            window=window_evidence(hypotheses, risk, self.lens),
            inliers=self._inliers(pair, hypotheses.motions[0]),
            moving=np.isin(pair.track_ids, risk.moving_tracks),
        )
        self._last = _Judged(pair, hypotheses, risk, attempt)
        # A camera that merely rotates is judged again once a pair shows parallax.
        self._rotating = risk.rotation > MERE_ROTATION
        self._lens_step = self.lens.step(risk.camera)
        max_risk = self._config.acceptance.max_risk
        reason, advice = _reason(hypotheses, risk, max_risk)
        if self.lens.is_unknown and _held_by_lens(reason, risk, max_risk):
            reason, advice = Verdict.UNKNOWN_FOCAL_LENGTH, self.lens.advice()
        gates = [at_most(GateName.RISK, risk.total, max_risk, reason, advice)]
        if self.lens.is_unknown:
            sigma, unknown = risk.camera.focal.sigma, Verdict.UNKNOWN_FOCAL_LENGTH
            gates.append(at_most(GateName.FOCAL_SIGMA, sigma, MAX_FOCAL_SIGMA, unknown, self.lens.advice()))
        attempt = with_gates(attempt, gates)
        if not all(gate.passes() for gate in gates):
            refused = refused_by(attempt, Stage.MAP, gates)
            if refused.verdict == Verdict.PURE_ROTATION:
                refused = replace(refused, rotation_only=rotation_evidence(hypotheses))
            return Outcome(refused, hypotheses=self._undecided(refused, pair, hypotheses), margin=risk.margin)
        # The stated risk is that of the pair. Each further view adds little; a view that is left out costs some
        # landmarks only.
        certain = _certain_frames(hypotheses, risk, _RISK_OF_A_VIEW)
        state = hypotheses.motions[0].fit.state
        if self.lens.is_unknown:  # the frames after the map see through its lens
            self._lens_step = (state.log_scale, state.k1)
        bundle, table = self._agreeing_map(self._last, certain)
        attempt = replace(attempt, frames=table.frames)
        return replace(self._usable(attempt, bundle, hypotheses), margin=risk.margin)

    def _confirmed(self, hypotheses: WindowHypotheses) -> tuple[WindowHypotheses, WindowRisk]:
        """The hypotheses and their risk; where it is small, after a second look."""
        risk = risk_of(hypotheses)
        again, risk = confirmed(hypotheses, risk, self._config.acceptance.max_risk)
        if again is not hypotheses:
            self._live.keep(again)
        return again, risk

    def _inliers(self, pair: MatchedPair, motion: FittedMotion) -> Bools:
        """The matches that a motion explains, seen through the lens that was fitted with it."""
        state = motion.fit.state
        if self.lens.is_unknown and (state.log_scale or state.k1):
            camera = self.lens.camera.refocused(state.log_scale, state.k1)
            pair = replace(pair, rays1=camera.bearings(pair.pixels1), rays2=camera.bearings(pair.pixels2))
        return _inliers(pair, motion.cam2_from_cam1, self._threshold_rad)

    def _with_readout(self, pair: MatchedPair, risk: WindowRisk) -> MatchedPair:
        """Correct the rays of the history for the readout that the window found; return the pair with these rays."""
        readout = risk.camera.readout
        if readout is None or not self._shutter.adopt(self._history, readout.told_seconds):
            return pair
        return self._matched(pair.preview, self._history[pair.current.frame])

    def _matched(self, preview: PairPreview, current: Observations) -> MatchedPair:
        """The matches of a pair, without those that lie on the image and not in the scene."""
        pair = match_pair(self._history, preview, current)
        further = voting_views(
            self._history, pair.reference, current, self._config.map, MAX_VIEWS - 2, self._live.frames
        )
        self._further = further if self._third_view else []
        self._static = static_tracks(pair.reference, current, further)
        if not len(self._static):
            return pair
        matches = pair.at(np.flatnonzero(~np.isin(pair.track_ids, self._static)))
        return replace(
            matches, reference=without(pair.reference, self._static), current=without(pair.current, self._static)
        )

    def _undecided(self, refused: Attempt, pair: MatchedPair, hypotheses: WindowHypotheses) -> tuple[InitialMap, ...]:
        """The maps of both motions of a plane that the tracks do not decide between."""
        if refused.verdict != Verdict.AMBIGUOUS_PLANE:
            return ()
        both = (self._built(self._map(pair, motion)[0], hypotheses) for motion in hypotheses.motions[:2])
        maps = tuple(one.map for one in both if one is not None)
        return maps if len(maps) == 2 else ()

    def _agreeing_map(self, last: _Judged, frames: Sequence[int]) -> tuple[BundleSolution | BundleFailure, TrackTable]:
        """The map of the best motion, which bundle adjustment has not moved away from the motion.

        A further view that moves away is left out. Where the pair moves, the joint estimate gives priors of the poses.
        It knows more than the landmarks: tracks with uncertain depths, and that the points lie on a plane.
        """
        motion = last.hypotheses.motions[0]
        bundle, table = self._map(last.pair, motion, frames)
        moved = _moved_frames(bundle, motion)
        if moved and frames[1] not in moved:
            bundle, table = self._map(last.pair, motion, [frame for frame in frames if frame not in moved])
            moved = _moved_frames(bundle, motion)
        if moved:
            sigmas = np.radians([last.risk.rotation_sigma_deg, last.risk.direction_sigma_deg])
            bundle, table = self._map(last.pair, motion, frames, PosePrior(*sigmas.tolist()))
        return bundle, table

    def _map(
        self,
        pair: MatchedPair,
        motion: FittedMotion,
        frames: Sequence[int] | None = None,
        prior: PosePrior | None = None,
    ) -> tuple[BundleSolution | BundleFailure, TrackTable]:
        """The bundle-adjusted map of a fitted motion, on all tracks of the pair and in the given frames."""
        views = [self._history[frame] for frame in (motion.frames if frames is None else frames)[2:]]
        table = table_of(pair.reference, pair.current, views)
        if self._shutter.readout_s:
            pixels = np.array([self.lens.camera.project(bearings) for bearings in table.bearings])
            table = replace(table, pixels=pixels)
        poses, state = motion.motion.cam_from_world, motion.fit.state
        if self.lens.is_unknown:
            camera = self.lens.camera.refocused(state.log_scale, state.k1)
            table = replace(table, bearings=np.array([camera.bearings(pixels) for pixels in table.pixels]))
            return map_of_poses(camera, self._config, table, poses, self._threshold_rad, prior), table
        options = self._config.map
        # A focal length that is certain to be off would bend the map. An estimate within its own standard deviation is
        # no reason to leave a calibration: errors that neighbouring tracks share pull it by a tenth on a board.
        sigma = self._last.risk.camera.focal.sigma if self._last is not None else math.inf
        if abs(state.log_scale) > max(CALIBRATED_SIGMA, _CERTAIN_FOCAL_SIGMAS * sigma):
            options = replace(options, refine_focal=True, focal_sigma=CALIBRATED_SIGMA)
        config = replace(self._config, map=options)
        factor = math.exp(state.log_scale)
        return map_of_poses(self.lens.camera, config, table, poses, self._threshold_rad, prior, factor), table

    def _built(
        self, bundle: BundleSolution | BundleFailure, hypotheses: WindowHypotheses, risk: float | None = None
    ) -> MapWithViews | None:
        if not isinstance(bundle, BundleSolution):
            return None
        built = map_with_views(self._history, bundle, "planar" if hypotheses.planar else "general")
        map_, camera = built.map, built.map.camera
        if self.lens.camera.readout_s is None and self._shutter.readout_s:
            camera = camera.with_readout(self._shutter.readout_s)
        if self.lens.is_unknown and self._last is not None:
            sigma = min(self._last.risk.camera.focal.sigma, 1.0)
            camera = replace(camera, source="estimated", focal_sigma=sigma)
            factor = camera.fx / self.lens.stated.fx
            map_ = replace(map_, focal_factor=factor, focal_factor_sigma=factor * sigma)
        return replace(built, map=replace(map_, camera=camera, risk=risk))

    def _usable(
        self, attempt: Attempt, bundle: BundleSolution | BundleFailure, hypotheses: WindowHypotheses
    ) -> Outcome:
        """Refuse a map that cannot be used, although its motion is right: unknown depths, few landmarks, no map."""
        if not isinstance(bundle, BundleSolution):
            attempt = replace(attempt, map=MapEvidence(failure=bundle.cause))
            return Outcome(refused_at(attempt, Verdict.BUNDLE_ADJUSTMENT_FAILED, Stage.MAP))
        evidence = MapEvidence(bundle.rmse_px, pose_prior=bundle.problem.prior is not None)
        attempt = replace(attempt, map=evidence)
        landmarks = at_least(
            GateName.LANDMARKS,
            len(bundle.problem.points),
            self._config.acceptance.min_landmarks,
            Verdict.TOO_FEW_LANDMARKS,
        )
        gates = (*depth_gates(bundle, self._config.acceptance), landmarks)
        attempt = with_gates(attempt, gates)
        if not all(gate.passes() for gate in gates):
            return Outcome(refused_by(attempt, Stage.MAP, gates))
        if _moved_frames(bundle, hypotheses.motions[0]):
            attempt = replace(attempt, map=MapEvidence(failure="the adjusted motion differs from that of the window"))
            return Outcome(refused_at(attempt, Verdict.BUNDLE_ADJUSTMENT_FAILED, Stage.MAP))
        risk = None if self._last is None else self._last.risk.total
        return Outcome(replace(attempt, progress=1.0), accepted=self._built(bundle, hypotheses, risk))


def _inliers(pair: MatchedPair, pose: Pose, threshold_rad: float) -> Bools:
    """The matches of the pair that a motion explains, with points in front of both cameras."""
    m, n = pair.rays1, pair.rays2
    depths1, depths2 = depths_from_pose(pose.R, pose.t, m, n)
    normal = np.cross(np.broadcast_to(pose.t, m.shape), m @ pose.R.T)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    near = np.abs(np.einsum("ij,ij->i", n, normal)) < np.sqrt(2) * threshold_rad
    return np.asarray(near & (depths1 > 0) & (depths2 > 0))


def _moved_frames(bundle: BundleSolution | BundleFailure, motion: FittedMotion) -> tuple[int, ...]:
    """The keyframes whose motion from the reference is not that of the window any more, after bundle adjustment.

    Bundle adjustment does not know that points lie on a plane, nor the error fields: views with short baselines may
    move far. A failure moved none.
    """
    if not isinstance(bundle, BundleSolution):
        return ()
    world_from_cam = dict(zip(bundle.problem.frames, bundle.problem.world_from_cam, strict=True))
    fitted, reference = motion.motion.cam_from_world, motion.frames[0]
    moved = []
    for frame in set(world_from_cam) - {reference}:
        adjusted = world_from_cam[frame].inverse() @ world_from_cam[reference]
        rotation_deg, direction_deg = difference_deg(fitted[frame], adjusted)
        if rotation_deg > _ADJUSTED_ROTATION_DEG or direction_deg > _ADJUSTED_DIRECTION_DEG:
            moved.append(frame)
    return tuple(moved)


def _certain_frames(hypotheses: WindowHypotheses, risk: WindowRisk, most: float) -> tuple[int, ...]:
    """Reference, current, and the views whose own directions are at most as risky: the keyframes of the map."""
    reference, current, *others = hypotheses.motions[0].frames
    risks = zip(others, risk.direction_of_views[1:], strict=True)
    return (reference, current, *(frame for frame, one in risks if one <= most))


def _held_by_lens(reason: Verdict, risk: WindowRisk, max_risk: float) -> bool:
    """Whether the direction would be known well enough if the focal length were."""
    by_direction = reason in (Verdict.LOW_PARALLAX, Verdict.MOVING_BODIES) and risk.direction >= risk.rival
    wide = risk.camera.focal.sigma > MAX_FOCAL_SIGMA
    return by_direction and wide and risk.direction_with_known_lens <= max_risk


def _reason(hypotheses: WindowHypotheses, risk: WindowRisk, max_risk: float) -> tuple[Verdict, str | None]:
    """The verdict and the advice: no translation if it is not significant, else the largest term of the risk."""
    # A rotation with a wrong focal length looks like a plane with two motions: then neither motion may be right.
    unlikely = max_risk if hypotheses.planar and risk.rival >= risk.direction else _INSIGNIFICANT
    if risk.rotation > unlikely or risk.rotation >= max(risk.rival, risk.direction):
        return Verdict.PURE_ROTATION, None
    if risk.moving >= max(risk.rival, risk.direction_if_rigid):
        return Verdict.MOVING_BODIES, None
    if risk.rival >= risk.direction:
        if hypotheses.planar:
            return Verdict.AMBIGUOUS_PLANE, None
        return Verdict.LOW_PARALLAX, "two motions explain the tracks: translate further, best sideways"
    # A rigid scene with these tracks would be known well enough.
    return (Verdict.LOW_PARALLAX if risk.direction_if_rigid > max_risk else Verdict.MOVING_BODIES), None
