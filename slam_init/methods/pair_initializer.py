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
from slam_init.frontend.frame_clock import FrameClock
from slam_init.frontend.matched_tracks import make_tracker
from slam_init.mapping.map_building import initial_map
from slam_init.methods.two_view import TwoViewMethod, undistorted_pixels
from slam_init.recording.recorder import Recorder
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.evidence import MapEvidence
from slam_init.types.frame import Frame, Observations
from slam_init.types.history import common_tracks
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose
from slam_init.types.refusal import GateName, Verdict, at_least
from slam_init.types.result import Attempt, Result
from slam_init.types.status import Status, frame_of
from slam_init.types.stopwatch import Stopwatch

#: None of the two-view methods tests the uncertainty of a depth. So their landmarks are kept, unless their depth is
#: entirely uncertain after bundle adjustment.
_ANY_DEPTH_SIGMA = 1.0
#: Least depth of a ray on an image plane: at 89.4 degrees from the axis. The planar lens models end at 89 degrees.
_LEAST_DEPTH = 0.01
#: Verdicts after which the reference frame is replaced, because its tracks are lost.
_NEW_REFERENCE = (Verdict.TOO_FEW_FEATURES, Verdict.TOO_FEW_MATCHES)


class PairInitializer:
    """Takes frames until the method accepts a pair; has the interface of :class:`slam_init.initializer.Initializer`.

    * ``camera``: The calibration of the images.
    * ``config``: Options of the tracker and of bundle adjustment; the method has its own constants.
    * ``recorder``: Receives a report of each frame, attempt and map.
    * ``status``: The status after the last frame. Its progress stays 0 until there is a map, because the rules of other
      systems have no measure of progress.
    * ``tracker``: Follows the tracks; it can be used after the initialization.
    * ``history``: The observations of the last frames.
    """

    def __init__(
        self, method: TwoViewMethod, camera: Camera, config: Config | None = None, recorder: Recorder | None = None
    ) -> None:
        self.method = method
        self.camera = camera
        self.config = config or Config()
        self.recorder = recorder or Recorder()
        self.tracker = make_tracker(camera, self.config.tracking)
        self.history = self.tracker.history
        self._clock = FrameClock(self.history)
        self.stopwatch = Stopwatch()
        self.status = Status()
        self._reference: int | None = None
        self._attempts = AttemptLog()
        # A map of two views is final at once.
        self._maps = MapCandidates(self.recorder, replace(self.config, refine_frames=0))

    @property
    def map(self) -> InitialMap | None:
        """The accepted map; None without one."""
        return self._maps.accepted

    @property
    def frames_read(self) -> int:
        """Number of frames that the initializer was given."""
        return self._maps.frames

    def process(self, image: Image | Frame, timestamp_s: float | None = None) -> Status:
        """Process the next image (H, W); see :meth:`slam_init.initializer.Initializer.process`."""
        if self.map is not None:
            return self.status
        frame = frame_of(image, timestamp_s, self.history.newest + 1, self.camera)
        own_seconds = timestamp_s is None or isinstance(image, Frame)
        frame = self._clock.stamped(frame, in_seconds_by_type=own_seconds)
        with self.stopwatch("track"):
            current = self.tracker.track(frame)
        self.recorder.frame(frame, current)
        return self._step(current)

    def process_tracks(self, current: Observations, *, revised: Sequence[Observations] = ()) -> Status:
        """Process the tracks of the next frame; see :meth:`slam_init.initializer.Initializer.process_tracks`."""
        if self.map is not None:
            return self.status
        self._clock.check_tracks(current)
        return self._step(current, revised)

    def _step(self, current: Observations, revised: Sequence[Observations] = ()) -> Status:
        """Process the tracks of the next frame, whose time is checked."""
        self.history.add(current, revised)
        self._clock.took(current)
        self._maps.count(current.frame)
        attempt = None
        if self._reference is not None:
            outcome = self._try(self.history[self._reference], current)
            attempt = outcome.attempt
            self.recorder.attempt(attempt)
            self._attempts.add(attempt)
            self._maps.keep(outcome)
        if self._reference is None or (attempt is not None and attempt.verdict in _NEW_REFERENCE):
            self._refer_to(current)
        self._attempts.forget_progress(keep=())  # none of these methods has a measure of progress
        self.history.forget(keep=() if self._reference is None else (self._reference,))
        self.status = self.status.after(attempt, 0.0) if self.map is None else Status.initialized(attempt)
        return self.status

    def _refer_to(self, observed: Observations | None) -> None:
        """Pair later frames with this one, if it has enough features."""
        enough = observed is not None and len(observed) >= self.method.pair_rule.min_features
        self._reference = observed.frame if observed is not None and enough else None

    def finish(self) -> Result:
        """End the sequence. The result is the same as :attr:`result`."""
        return self.result

    @property
    def result(self) -> Result:
        """The result up to now: the map, or the reason why there is none."""
        result = self._maps.result(self._attempts, self.camera, self._clock.notes, self.stopwatch.summary())
        if result.reason == Verdict.TOO_FEW_FRAMES and self.frames_read > 1:
            # No frame had enough features to become a reference.
            return replace(result, reason=Verdict.TOO_FEW_FEATURES, advice=Verdict.TOO_FEW_FEATURES.advice)
        return result

    def reset(self, since: int | None = None) -> None:
        """Restart; see :meth:`slam_init.initializer.Initializer.reset`.

        * ``since``: Absolute index of the first frame whose tracks the next map may use; by default the newest one.
        """
        newest = max(self.history.newest, 0)
        self.history.start_at(newest if since is None else min(since, newest))
        known = list(self.history)
        self._refer_to(known[0] if known else None)
        self._attempts, self.status = AttemptLog(), Status()
        self._maps.restart()
        for observed in known:
            self._maps.count(observed.frame)
            self._clock.took(observed)
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
