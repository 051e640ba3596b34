"""An initializer around a two-view method: reference frame, attempt at every frame, two-view bundle adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam_init.attempt_log import AttemptLog, focal_notes
from slam_init.bundle.adjustment import adjust
from slam_init.bundle.problem import BundleProblem, BundleSolution
from slam_init.config import Config
from slam_init.decision.refusal import Evidence, refusal, refused
from slam_init.frontend.tracks import Tracker, common_tracks
from slam_init.mapping.map_building import initial_map
from slam_init.methods.two_view import TwoViewMethod, TwoViewOutcome, undistorted_pixels
from slam_init.recording.recorder import Recorder
from slam_init.status import Status, frame_of
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose
from slam_init.types.reasons import ACCEPTED
from slam_init.types.result import Attempt, Result
from slam_init.types.stopwatch import Stopwatch

__all__ = ["PairInitializer"]

#: None of the two-view methods asks how certain a depth is: what they triangulate stays, unless bundle adjustment makes
#: its depth a guess.
_ANY_DEPTH_SIGMA = 1.0
#: The tracks of the reference are lost.
_NEW_REFERENCE = ("too_few_features", "too_few_matches")


class PairInitializer:
    """Feed it frames until the method accepts a pair; the same interface as :class:`slam_init.initializer.Initializer`.

    Parameters
    ----------
    method : TwoViewMethod
    camera : Camera
    config : Config
    recorder : Recorder, optional

    Attributes
    ----------
    map : InitialMap or None
    status : Status
        Its progress stays 0 until there is a map: the rules of other systems have no measure of how far they are.
    frames_read : int
    tracker : Tracker
    history : History
    """

    def __init__(
        self, method: TwoViewMethod, camera: Camera, config: Config | None = None, recorder: Recorder | None = None
    ) -> None:
        self.method = method
        self.camera = camera
        self.config = config or Config()
        self.recorder = recorder or Recorder()
        self.tracker = Tracker(camera, self.config.tracking)
        self.history = self.tracker.history
        self.stopwatch = Stopwatch()
        self.map: InitialMap | None = None
        self.status = Status()
        self.frames_read = 0
        self._next_index = 0
        self._reference: int | None = None
        self._attempts = AttemptLog()

    def process(self, image: Image | Frame, timestamp_s: float | None = None) -> Status:
        """Take in the next frame; see :meth:`slam_init.initializer.Initializer.process`."""
        if self.map is not None:
            return self.status
        frame = frame_of(image, timestamp_s, self._next_index, self.camera)
        with self.stopwatch("track"):
            current = self.tracker.track(frame)
        self.recorder.frame(frame, current)
        return self.process_tracks(current)

    def process_tracks(self, current: Observations, revised: Sequence[Observations] = ()) -> Status:
        """Take in the tracks of the next frame; see :meth:`slam_init.initializer.Initializer.process_tracks`."""
        if self.map is not None:
            return self.status
        self.history.take(current, revised)
        self.frames_read += 1
        self._next_index = current.frame + 1
        attempt = None
        if self._reference is not None:
            attempt = self._try(self.history[self._reference], current)
            self.recorder.attempt(attempt)
            self._attempts.add(attempt)
        if self._reference is None or (attempt is not None and attempt.verdict in _NEW_REFERENCE):
            enough = len(current) >= self.method.pair_rule.min_features
            self._reference = current.frame if enough else None
        if attempt is not None and attempt.verdict == ACCEPTED and self.map is not None:
            views = [self.history[keyframe.frame] for keyframe in self.map.keyframes]
            self.recorder.initialized(self.map, views)
        self.history.forget(keep=() if self._reference is None else (self._reference,))
        self.status = self.status.after(attempt, 0.0) if self.map is None else Status.initialized(attempt)
        return self.status

    def finish(self) -> Result:
        """No more frames: the same as :attr:`result`."""
        return self.result

    @property
    def result(self) -> Result:
        """What is known by now: the map, or the reason why there is none."""
        reason = None if self.map is not None else self._attempts.prevailing_reason()
        if reason == "too_few_frames" and self.frames_read > 1:
            reason = "too_few_features"  # no frame had enough of them to become a reference
        return Result(
            map=self.map,
            reason=reason,
            frames_read=self.frames_read,
            frames_to_init=self.frames_read if self.map is not None else None,
            attempts=self._attempts.kept,
            timing_ms=self.stopwatch.summary(),
            notes=(*self._attempts.notes(), *focal_notes(self.map, self.config.map)),
            advice="" if reason is None else self._attempts.advice(reason),
            hypotheses=() if self.map is None else (self.map,),
        )

    def _try(self, reference: Observations, current: Observations) -> Attempt:
        rule, frames = self.method.pair_rule, (reference.frame, current.frame)
        i, j = common_tracks(reference, current)
        evidence: Evidence = {"features": len(current), "matches": len(i)}
        if len(current) < rule.min_features:
            return refusal(frames, "too_few_features", evidence | {"features_needed": rule.min_features})
        if len(i) < rule.min_matches:
            return refusal(frames, "too_few_matches", evidence | {"matches_needed": rule.min_matches})
        m, n = reference.bearings[i], current.bearings[j]
        with self.stopwatch("two_view"):
            outcome = self.method.bootstrap(
                self.camera,
                undistorted_pixels(self.camera, m),
                undistorted_pixels(self.camera, n),
                m,
                n,
                self.config.seed,
            )
        attempt = Attempt(
            frames=frames,
            verdict=outcome.reason,
            evidence=evidence | outcome.evidence,
            pixels1=reference.pixels[i],
            pixels2=current.pixels[j],
            inliers=outcome.landmarks,
        )
        if outcome.cam2_from_cam1 is None:
            return refused(attempt, outcome.reason)
        with self.stopwatch("map"):
            return self._adjusted(attempt, outcome, outcome.cam2_from_cam1, reference, current)

    def _adjusted(
        self, attempt: Attempt, outcome: TwoViewOutcome, pose: Pose, reference: Observations, current: Observations
    ) -> Attempt:
        """Two-view bundle adjustment of what the method accepted; sets the map, or starts anew as the systems do."""
        i, j = common_tracks(reference, current)
        kept = np.flatnonzero(outcome.landmarks)
        count = len(kept)
        problem = BundleProblem(
            frames=(reference.frame, current.frame),
            world_from_cam=(Pose.identity(), pose.inverse()),
            points=outcome.points[kept],
            track_ids=reference.track_ids[i[kept]],
            views=np.repeat(np.arange(2), count),
            landmarks=np.tile(np.arange(count), 2),
            pixels=np.concatenate([reference.pixels[i[kept]], current.pixels[j[kept]]]),
        )
        bundle = adjust(self.camera, problem, replace(self.config.map, max_depth_sigma=_ANY_DEPTH_SIGMA))
        if not isinstance(bundle, BundleSolution):
            self._reference = None
            return refused(attempt, "bundle_adjustment_failed", {"cause": bundle.cause})
        needed = self.method.pair_rule.min_landmarks
        left = len(bundle.problem.points)
        evidence: Evidence = {"landmarks": left, "landmarks_gate": needed, "reprojection_rmse_px": bundle.rmse_px}
        attempt = replace(attempt, evidence=attempt.evidence | evidence)
        if left < needed:
            self._reference = None
            return refused(attempt, "too_few_landmarks")
        self.map = initial_map(bundle, (reference, current), "planar" if outcome.planar else "general")
        return attempt
