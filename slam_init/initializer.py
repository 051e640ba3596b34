"""The pipeline, to be read from top to bottom.

A frame arrives; its tracks are followed; the keyframe manager offers pairs with earlier frames; the best pair is tried
(:mod:`slam_init.attempt`): two-view geometry (:mod:`quest`), a map for each hypothesis, the vote of further views,
bundle adjustment, gates. The first map that passes all of them ends the initialization. What is refused is refused for
a reason, with its evidence; what cannot be decided lives on as two maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from slam_init.attempt import Handover, Outcome, screen, try_pair, with_calibration_check
from slam_init.attempt_log import AttemptLog, focal_notes
from slam_init.config import Config
from slam_init.frontend.keyframes import KeyframeManager, PairPreview
from slam_init.frontend.tracks import Tracker
from slam_init.recording.recorder import Recorder
from slam_init.status import Status, frame_of, progress
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.reasons import ACCEPTED
from slam_init.types.result import Attempt, Result
from slam_init.types.stopwatch import Stopwatch

__all__ = ["Initializer"]

#: What a later attempt may find that speaks against an earlier pair which no third view confirmed.
_AGAINST_TWO_VIEWS = ("pure_rotation", "no_consistent_motion", "ambiguous_plane", "bundle_adjustment_failed")
#: A camera that turned by less shows less than 0.2 px of a focal length that is wrong by a twentieth.
_FIRST_CHECK_DEG = 5.0


class Initializer:
    """Feed it frames until it has a map: images by :meth:`process`, or tracks of your own by :meth:`process_tracks`.

    Initializers share nothing: any number of them may work side by side. What each remembers is bounded, however long
    it waits: the observations of the last 150 frames and of a window of candidates, the last 1000 attempts, and two
    dozen bytes a frame for statistics.

    Parameters
    ----------
    camera : Camera
    config : Config, optional
    recorder : Recorder, optional
        Is told of every frame, attempt and map.
    third_view : bool
        Whether further views decide between two motions and confirm the map. Without them the better two-view map is
        taken where the gates that two views allow are passed: the method ``quest-two-view``.

    Attributes
    ----------
    map : InitialMap or None
        Set when a map was accepted.
    status : Status
        As the last frame left it.
    frames_read : int
    tracker : Tracker
    history : History
        What was seen in the last frames; :attr:`tracker` adds to the same one.
    """

    def __init__(
        self,
        camera: Camera,
        config: Config | None = None,
        recorder: Recorder | None = None,
        *,
        third_view: bool = True,
    ) -> None:
        self.camera = camera
        self.config = config or Config()
        self.recorder = recorder or Recorder()
        self.tracker = Tracker(camera, self.config.tracking)
        self.history = self.tracker.history
        self.keyframes = KeyframeManager(camera, self.config)
        self.stopwatch = Stopwatch()
        self.map: InitialMap | None = None
        self.status = Status()
        self.frames_read = 0
        self._third_view = third_view
        self._next_index = 0
        self._next_check_deg = _FIRST_CHECK_DEG
        self._attempts = AttemptLog()
        self._progress: dict[int, float] = {}  # by candidate reference
        self._unconfirmed: tuple[Attempt, Handover] | None = None
        self._hypotheses: tuple[InitialMap, ...] = ()
        self._margin: Margin | None = None

    def process(self, image: Image | Frame, timestamp_s: float | None = None) -> Status:
        """Take in the next frame, and tell how far the initialization is.

        Parameters
        ----------
        image : (H, W) or (H, W, 3) uint8, or Frame
            Grey or BGR, of the size that the camera is calibrated for; or a frame of a source, which has an index, a
            name and a time of its own.
        timestamp_s : float, optional
            For the trajectory. Without it an image's time is its index.

        Returns
        -------
        Status
            Truthy once there is a map. From then on frames are no longer taken in: go on with :attr:`tracker`.

        Raises
        ------
        SlamInitError
            Where the array is no such image, or a frame comes after a later one.
        """
        if self.map is not None:
            return self.status
        frame = frame_of(image, timestamp_s, self._next_index, self.camera)
        with self.stopwatch("track"):
            current = self.tracker.track(frame)
        self.recorder.frame(frame, current)
        return self.process_tracks(current)

    def process_tracks(self, current: Observations, revised: Sequence[Observations] = ()) -> Status:
        """Take in the tracks of the next frame, found elsewhere: a cache, or features and matches of your own.

        Feed either images or tracks: the tracker knows nothing of track ids that it did not give.

        Parameters
        ----------
        current : Observations
            One feature of the world has one track id in all frames. Frames come in ascending order.
        revised : sequence of Observations, optional
            Earlier frames of which more is known by now (see :attr:`slam_init.frontend.tracks.Tracker.revised`); those that
            were not fed, or are forgotten, are passed over.

        Returns
        -------
        Status
            As :meth:`process`.

        Raises
        ------
        SlamInitError
            Where the arrays do not belong together, a bearing is not finite, or the frame is not the next one.
        """
        if self.map is not None:
            return self.status
        self.history.take(current, revised)
        self.frames_read += 1
        self._next_index = current.frame + 1
        with self.stopwatch("pairs"):
            pairs = self.keyframes.preview(self.history, current)
            chosen = self.keyframes.worth_trying(pairs)
        attempt = screen(self.camera, self.config, current, pairs)
        if attempt is not None:
            attempt = self._with_calibration_check(attempt, pairs, current)
            self._remember(attempt)
        elif chosen is not None:
            attempt = self._try(chosen, pairs, current)
        self.keyframes.update(current, pairs)
        self.history.forget(keep=self.keyframes.candidates)
        self._progress = {frame: self._progress.get(frame, 0.0) for frame in self.keyframes.candidates}
        if self.map is None:
            self.status = self.status.after(attempt, max(self._progress.values(), default=0.0))
        else:
            self.status = Status.initialized(attempt)
        return self.status

    @property
    def result(self) -> Result:
        """What is known by now: the map, or the reason why there is none and the maps that are kept."""
        reason = None if self.map is not None else self._attempts.prevailing_reason()
        return Result(
            map=self.map,
            reason=reason,
            frames_read=self.frames_read,
            frames_to_init=self.frames_read if self.map is not None else None,
            attempts=self._attempts.kept,
            timing_ms=self.stopwatch.summary(),
            notes=(*self._attempts.notes(), *focal_notes(self.map, self.config.map)),
            advice="" if reason is None else self._attempts.advice(reason),
            hypotheses=self._hypotheses,
            margin=self._margin,
        )

    def finish(self) -> Result:
        """No more frames: the result, with the map of a pair that two views decide and no third one was there for."""
        if self.map is None and self._unconfirmed is not None:
            attempt, handover = self._unconfirmed
            accepted = replace(attempt, verdict=ACCEPTED, advice="", progress=1.0)
            self._remember(accepted)
            self._hand_over(handover)
            self.status = Status.initialized(accepted)
        return self.result

    # -- one frame --------------------------------------------------------------------------------

    def _try(self, pair: PairPreview, pairs: Sequence[PairPreview], current: Observations) -> Attempt:
        """Try a pair, and keep what came of it."""
        outcome = try_pair(
            self.camera, self.config, self.history, pair, current, self.stopwatch, third_view=self._third_view
        )
        attempt = self._with_calibration_check(outcome.attempt, pairs, current)
        self._remember(attempt)
        if attempt.verdict in _AGAINST_TWO_VIEWS:
            self._unconfirmed = None
        if outcome.margin is not None or outcome.accepted is not None:
            self._margin = outcome.margin
        if outcome.accepted is not None:
            self._hand_over(outcome.accepted)
        else:
            self.keyframes.failed(pair, attempt.lacking, as_map=attempt.progress >= progress("map"))
            if outcome.unconfirmed is not None:
                self._unconfirmed = attempt, outcome.unconfirmed
            self._keep_hypotheses(outcome)
        return attempt

    def _with_calibration_check(self, attempt: Attempt, pairs: Sequence[PairPreview], current: Observations) -> Attempt:
        """What a camera that only turned tells of its focal length, if it turned further than at the last check."""
        if attempt.verdict != "pure_rotation" or "turning_focal_factor" in attempt.evidence:
            return attempt
        needed = self.config.keyframes.min_matches
        farthest = max(pairs, key=lambda pair: (pair.matches >= needed, pair.rotation_deg))
        if farthest.rotation_deg < self._next_check_deg:
            return attempt
        # Each check costs as much as a frame, and what has turned a little further says the same.
        self._next_check_deg = self.config.keyframes.retry_gain * farthest.rotation_deg
        return with_calibration_check(self.camera, self.config, attempt, self.history[farthest.reference], current)

    def _keep_hypotheses(self, outcome: Outcome) -> None:
        """Two maps live on until other ones take their place, a vote decides, or a turning camera explains them."""
        decided = outcome.margin is not None and outcome.margin.decides()
        if outcome.hypotheses or decided or "suspected_focal_factor" in outcome.attempt.evidence:
            self._hypotheses = outcome.hypotheses
            self.recorder.undecided(self._hypotheses)

    def _hand_over(self, handover: Handover) -> None:
        self.map = handover.map
        self._hypotheses = (handover.map,)
        self.recorder.initialized(handover.map, handover.views)

    def _remember(self, attempt: Attempt) -> None:
        self.recorder.attempt(attempt)
        self._attempts.add(attempt)
        reference = attempt.frames[0]
        self._progress[reference] = max(self._progress.get(reference, 0.0), attempt.progress)
