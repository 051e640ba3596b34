"""An initializer that runs a two-view method: reference frame, attempt at each frame, two-view bundle adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam_init.bundle.adjustment import adjust
from slam_init.bundle.problem import BundleProblem, BundleSolution
from slam_init.config import Config
from slam_init.decision.attempt_log import AttemptLog
from slam_init.decision.map_candidates import MapCandidates, Outcome
from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.intake import Turn
from slam_init.mapping.map_building import initial_map
from slam_init.methods.two_view import TwoViewMethod, undistorted_pixels
from slam_init.recording.recorder import Recorder
from slam_init.types.camera import Camera
from slam_init.types.evidence import MapEvidence
from slam_init.types.frame import Observations
from slam_init.types.history import common_tracks
from slam_init.types.inertial import Gravity
from slam_init.types.pose import Pose
from slam_init.types.refusal import GateName, Verdict, at_least
from slam_init.types.result import Attempt, Result
from slam_init.types.status import Status

#: None of the two-view methods tests the uncertainty of a depth. So their landmarks are kept, unless their depth is
#: entirely uncertain after bundle adjustment.
_ANY_DEPTH_SIGMA = 1.0
#: Least depth of a ray on an image plane: at 89.4 degrees from the axis. The planar lens models end at 89 degrees.
_LEAST_DEPTH = 0.01
#: Verdicts after which the reference frame is replaced, because its tracks are lost.
_NEW_REFERENCE = (Verdict.TOO_FEW_FEATURES, Verdict.TOO_FEW_MATCHES)


class PairInitializer(Initializer):
    """Takes frames until the method accepts a pair, in the place of the keyframes and the window of an initializer.

    * ``method``: Has its own constants.
    * ``config``: Options of the tracker and of bundle adjustment.
    * ``status``: Its progress stays 0 until there is a map, because the rules of other systems have no measure of
      progress.
    """

    def __init__(
        self, method: TwoViewMethod, camera: Camera, config: Config | None = None, recorder: Recorder | None = None
    ) -> None:
        super().__init__(camera, config, recorder)
        self.method = method
        self._reference: int | None = None
        # A map of two views is final at once.
        self._maps = MapCandidates(self.recorder, replace(self.config, refine_frames=0))

    def _step(
        self, current: Observations, revised: Sequence[Observations], turn: Turn | None, gravity: Gravity | None
    ) -> Status:
        self.intake.add(current, revised, turn, gravity)
        self._maps.count(current.frame)
        attempt = None
        if self._reference is not None:
            outcome = self._try(self.history[self._reference], current)
            attempt = self._attempts.add(outcome.attempt)
            self.recorder.attempt(attempt)
            if outcome.accepted is not None:
                self.intake.check_gravity(outcome.accepted)
            self._maps.keep(outcome)
        if self._reference is None or (attempt is not None and attempt.verdict in _NEW_REFERENCE):
            self._refer_to(current)
        self._attempts.forget_progress(keep=())  # none of these methods has a measure of progress
        self.history.forget(keep=() if self._reference is None else (self._reference,))
        self.status = self.status.after(attempt, 0.0) if self.map is None else Status.initialized(attempt)
        return self.status

    def _refer_to(self, observed: Observations) -> None:
        """Pair later frames with this one, if it has enough features."""
        self._reference = observed.frame if len(observed) >= self.method.pair_rule.min_features else None

    @property
    def result(self) -> Result:
        """The result up to now: the map, or the reason why there is none."""
        result = super().result
        if result.reason == Verdict.TOO_FEW_FRAMES and self.frames_read > 1:
            # No frame had enough features to become a reference.
            return replace(result, reason=Verdict.TOO_FEW_FEATURES, advice=Verdict.TOO_FEW_FEATURES.advice)
        return result

    def reset(self, since: int | None = None) -> None:
        """Restart; see :meth:`slam_init.initializer.Initializer.reset`."""
        self._maps.restart()
        self._attempts, self.status = AttemptLog(), Status()
        known = self.intake.restart(since)
        self._reference = None
        if known:
            self._refer_to(self.history[known[0]])
        for frame in known:
            self._maps.count(frame)
        self.recorder.restarted()

    def _try(self, reference: Observations, current: Observations) -> Outcome:
        """Run the method on a pair, and build the map if the pair is accepted."""
        i, j = common_tracks(reference, current)
        # Rays that have a place on the image plane: these methods know no others.
        ahead = (reference.bearings[i, 2] > _LEAST_DEPTH) & (current.bearings[j, 2] > _LEAST_DEPTH)
        i, j = i[ahead], j[ahead]
        rule = self.method.pair_rule
        gates = (
            at_least(GateName.FEATURES, len(current), rule.min_features, Verdict.TOO_FEW_FEATURES),
            at_least(GateName.MATCHES, len(i), rule.min_matches, Verdict.TOO_FEW_MATCHES),
        )
        attempt = Attempt((reference.frame, current.frame), Verdict.ACCEPTED).with_gates(gates)
        if attempt.failed_gates:
            return Outcome(attempt.refused_at(attempt.failed_gates[0].reason))
        m, n = reference.bearings[i], current.bearings[j]
        x1, x2 = undistorted_pixels(self.camera, m), undistorted_pixels(self.camera, n)
        with self.stopwatch("two_view"):
            outcome = self.method.bootstrap(self.camera, x1, x2, m, n, self.config.seed)
        pixels1, pixels2, inliers = reference.pixels[i], current.pixels[j], outcome.landmarks
        attempt = replace(attempt, verdict=outcome.verdict, method_evidence=outcome.evidence)
        attempt = replace(attempt, pixels1=pixels1, pixels2=pixels2, inliers=inliers)
        pose = outcome.cam2_from_cam1
        if pose is None:
            return Outcome(attempt.refused_at(outcome.verdict))
        if problem := pose.problem():
            raise SlamInitError(f"method {self.config.method}: the pose of frames {attempt.frames} {problem}")
        count = int(inliers.sum())
        problem_of_pair = BundleProblem(
            frames=(reference.frame, current.frame),
            world_from_cam=(Pose.identity(), pose.inverse()),
            points=outcome.points[inliers],
            track_ids=reference.track_ids[i[inliers]],
            views=np.repeat(np.arange(2), count),
            landmarks=np.tile(np.arange(count), 2),
            pixels=np.concatenate([pixels1[inliers], pixels2[inliers]]),
        )
        with self.stopwatch("map"):
            return self._adjusted(attempt, problem_of_pair, "planar" if outcome.planar else "general")

    def _adjusted(self, attempt: Attempt, problem: BundleProblem, scene: str) -> Outcome:
        """Adjust the accepted pair and build the map. If this fails, drop the reference, as the other systems do."""
        bundle = adjust(self.camera, problem, replace(self.config.map, max_depth_sigma=_ANY_DEPTH_SIGMA))
        if not isinstance(bundle, BundleSolution):
            self._reference = None
            failed = replace(attempt, map=MapEvidence(failure=bundle.cause))
            return Outcome(failed.refused_at(Verdict.BUNDLE_ADJUSTMENT_FAILED))
        count, needed = len(bundle.problem.points), self.method.pair_rule.min_landmarks
        landmarks = at_least(GateName.LANDMARKS, count, needed, Verdict.TOO_FEW_LANDMARKS)
        attempt = replace(attempt.with_gates((landmarks,)), map=MapEvidence(reprojection_rmse_px=bundle.rmse_px))
        if not landmarks.passes():
            self._reference = None
            return Outcome(attempt.refused_at(Verdict.TOO_FEW_LANDMARKS))
        views = tuple(self.history[frame] for frame in bundle.problem.frames)
        return Outcome(attempt, initial_map(bundle, views, scene, self.history.gravities), views)
