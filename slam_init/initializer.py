"""The pipeline, to be read from top to bottom.

For each frame, the tracker follows the tracks, and the keyframe manager previews the pairs with earlier frames. If no
pair shows enough tracks, motion or parallax, the frame is refused (:func:`~slam_init.decision.screening.screen`).
Otherwise the best pair that need not wait is tried (:mod:`slam_init.attempt`): two-view geometry (:mod:`quest`), a
bundle-adjusted map for each hypothesis, the vote of further views, gates. The first map that passes all gates ends the
initialization. A refusal has a reason and its evidence. If the views cannot decide between two maps, both are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from slam_init.attempt import try_pair
from slam_init.attempt_log import AttemptLog, focal_notes
from slam_init.config import Config
from slam_init.decision.focal_check import FocalCheck
from slam_init.decision.outcome import Outcome
from slam_init.decision.screening import screen
from slam_init.frontend.keyframes import KeyframeManager, PairPreview
from slam_init.frontend.tracks import Tracker
from slam_init.mapping.map_building import MapWithViews
from slam_init.recording.recorder import Recorder
from slam_init.status import Status, frame_of
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.comparison import Margin
from slam_init.types.frame import Frame, Observations
from slam_init.types.gates import Stage
from slam_init.types.initial_map import InitialMap
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt, ProvisionalMap, Result
from slam_init.types.stopwatch import Stopwatch

if TYPE_CHECKING:
    from slam_init.decision.window_rule import WindowRule

__all__ = ["Initializer"]


class Initializer:
    """Takes frames until it has a map: images by :meth:`process`, or tracks of your own by :meth:`process_tracks`.

    Initializers share no state, so any number of them can run side by side. The memory of each one is bounded for a
    video of any length: the observations of the last 150 frames and of a window of candidates, the last 1000 attempts,
    and two dozen bytes a frame for statistics.

    Parameters
    ----------
    camera : Camera
        The calibration of the images.
    config : Config, optional
        All options; the defaults suit video and photo sets.
    recorder : Recorder, optional
        Receives a report of each frame, attempt and map.
    third_view : bool
        Whether further views decide between two motions and confirm the map. Without them, the better two-view map is
        accepted if it passes the gates that need no third view; this is the method ``quest-two-view``.

    Attributes
    ----------
    map : InitialMap or None
        The accepted map.
    status : Status
        The status after the last frame.
    frames_read : int
        Number of frames that the initializer was given.
    tracker : Tracker
        Follows the tracks; it can be used after the initialization.
    history : History
        The observations of the last frames; :attr:`tracker` adds to it.
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
        self.status = Status()
        self.frames_read = 0
        self._third_view = third_view
        self._next_index = 0
        self._focal_check = FocalCheck(camera, self.config)
        self._attempts = AttemptLog()
        self._maps = _MapsSoFar(self.recorder)
        self._window: WindowRule | None = None

    def process(self, image: Image | Frame, timestamp_s: float | None = None) -> Status:
        """Process the next frame.

        Parameters
        ----------
        image : (H, W) or (H, W, 3) uint8, or Frame
            Grey or BGR, of the size that the camera is calibrated for; or a frame of a source, which has its own index,
            name and time.
        timestamp_s : float, optional
            In seconds, for the trajectory. Without it the time of an image is its index.

        Returns
        -------
        Status
            Truthy once there is a map. From then on this method ignores frames; use :attr:`tracker`.

        Raises
        ------
        SlamInitError
            If the array is not such an image, or the frame is earlier than the last one.
        """
        if self.map is not None:
            return self.status
        frame = frame_of(image, timestamp_s, self._next_index, self.camera)
        with self.stopwatch("track"):
            current = self.tracker.track(frame)
        self.recorder.frame(frame, current)
        return self.process_tracks(current)

    def process_tracks(self, current: Observations, revised: Sequence[Observations] = ()) -> Status:
        """Process the tracks of the next frame from elsewhere: from a cache, or from features and matches of your own.

        Give an initializer either images or tracks, because its tracker cannot continue tracks with other ids.

        Parameters
        ----------
        current : Observations
            The tracks of the frame. A point of the scene has the same track id in all frames. The frames are in
            ascending order.
        revised : sequence of Observations, optional
            Earlier frames with more tracks than before (see :attr:`slam_init.frontend.tracks.Tracker.revised`). Frames
            that are not in the history are ignored.

        Returns
        -------
        Status
            As for :meth:`process`.

        Raises
        ------
        SlamInitError
            If the shapes of the arrays do not fit together, a bearing is not finite, or the frame is not later than the
            last one.
        """
        if self.map is not None:
            return self.status
        self.history.take(current, revised)
        self.frames_read += 1
        self._next_index = current.frame + 1
        with self.stopwatch("pairs"):
            pairs = self.keyframes.preview(self.history, current)
            best = self.keyframes.best_pair_to_try(pairs)
        attempt = screen(self.camera, self.config, current, pairs)
        if attempt is not None:
            attempt = self._checked_and_logged(attempt, pairs, current)
        elif (outcome := self._judge(best, pairs, current)) is not None:
            attempt = self._checked_and_logged(outcome.attempt, pairs, current)
            self._maps.take(outcome)
            if self.map is None and best is not None:
                # The window keeps its motions from frame to frame, so it need not rest after a refused map.
                rest = attempt.stage is Stage.MAP and self._window is None
                self.keyframes.failed(best, attempt.parallax_shortfall, map_refused=rest)
        self.keyframes.update(current, pairs)
        self.history.forget(keep=self.keyframes.candidates)
        progress = self._attempts.best_progress(self.keyframes.candidates)
        self.status = self.status.after(attempt, progress) if self.map is None else Status.initialized(attempt)
        return self.status

    @property
    def map(self) -> InitialMap | None:
        """The accepted map; None without one."""
        return self._maps.accepted

    @property
    def provisional(self) -> ProvisionalMap | None:
        """The best map up to now with its risk; the accepted map once there is one.

        It is built when it is asked for, which takes as long as a bundle adjustment. None where no motion is known, and
        always with the rule "gates", which states no risk.
        """
        if self._window is None:
            return None
        accepted = self.status.attempt
        if self.map is not None and accepted is not None and accepted.window is not None:
            return ProvisionalMap(self.map, accepted.window.risk)
        return self._window.provisional()

    @property
    def result(self) -> Result:
        """The result up to now: the map, or the reason why there is none and the undecided maps."""
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
            hypotheses=self._maps.hypotheses,
            margin=self._maps.margin,
        )

    def finish(self) -> Result:
        """End the sequence. A two-view map that passed all gates but those for a third view is accepted now.

        Returns
        -------
        Result
        """
        if self.map is None and self._maps.unconfirmed is not None:
            attempt = replace(
                self._maps.unconfirmed.attempt, verdict=Verdict.ACCEPTED, advice="", stage=None, progress=1.0
            )
            self._log(attempt)
            self._maps.accept_unconfirmed()
            self.status = Status.initialized(attempt)
        return self.result

    # -- parts of the step of a frame -------------------------------------------------------------

    def _judge(self, pair: PairPreview | None, pairs: Sequence[PairPreview], current: Observations) -> Outcome | None:
        """Judge a frame by the rule of the configuration; None where there is nothing to judge."""
        if self.config.acceptance.rule == "window":
            if self._window is None:
                # Imported here, since it loads the compiler (0.3 s), as quest does where an estimation starts.
                from slam_init.decision.window_rule import WindowRule

                self._window = WindowRule(self.camera, self.config, self.history)
            return self._window.judge(pair, pairs, current, self.stopwatch)
        if pair is None:
            return None
        return try_pair(
            self.camera, self.config, self.history, pair, current, self.stopwatch, third_view=self._third_view
        )

    def _checked_and_logged(self, attempt: Attempt, pairs: Sequence[PairPreview], current: Observations) -> Attempt:
        """Add a check of the focal length to an attempt if one is due, and log the attempt."""
        attempt = self._focal_check(attempt, pairs, self.history, current)
        self._log(attempt)
        return attempt

    def _log(self, attempt: Attempt) -> None:
        self.recorder.attempt(attempt)
        self._attempts.add(attempt)


class _MapsSoFar:
    """The maps of the attempts up to now: an accepted map, a map without a third view, or two undecided maps.

    Parameters
    ----------
    recorder : Recorder
        Receives a report when a map is accepted, and when the undecided maps change.

    Attributes
    ----------
    accepted : InitialMap or None
    unconfirmed : Outcome or None
        The outcome of the last pair that lacked only a third view; None after an attempt that contradicts it.
    hypotheses : tuple of InitialMap
        The accepted map, or the two undecided ones.
    margin : Margin or None
        The vote of the accepted map, if it had one. Before that, the last vote between two maps.
        :meth:`accept_unconfirmed` does not change it.
    """

    #: Verdicts of a later attempt that contradict an earlier map without a third view.
    _AGAINST_TWO_VIEWS = (
        Verdict.PURE_ROTATION,
        Verdict.NO_CONSISTENT_MOTION,
        Verdict.AMBIGUOUS_PLANE,
        Verdict.BUNDLE_ADJUSTMENT_FAILED,
    )

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.accepted: InitialMap | None = None
        self.unconfirmed: Outcome | None = None
        self.hypotheses: tuple[InitialMap, ...] = ()
        self.margin: Margin | None = None

    def take(self, outcome: Outcome) -> None:
        """Keep the maps of an attempt, and drop the maps that it contradicts."""
        if outcome.attempt.verdict in self._AGAINST_TWO_VIEWS:
            self.unconfirmed = None
        if outcome.margin is not None or outcome.accepted is not None:
            self.margin = outcome.margin
        if outcome.accepted is not None:
            self._accept(outcome.accepted)
            return
        if outcome.unconfirmed is not None:
            self.unconfirmed = outcome
        # Two undecided maps are kept until two other maps replace them, a vote decides, or a rotation-only camera is
        # suspected.
        decided = outcome.margin is not None and outcome.margin.decides()
        if outcome.hypotheses or decided or outcome.attempt.suspected_focal_factor is not None:
            self.hypotheses = outcome.hypotheses
            self._recorder.undecided(self.hypotheses)

    def accept_unconfirmed(self) -> None:
        """Accept the map that lacked only a third view."""
        if self.unconfirmed is not None and self.unconfirmed.unconfirmed is not None:
            self._accept(self.unconfirmed.unconfirmed)

    def _accept(self, built: MapWithViews) -> None:
        self.accepted = built.map
        self.hypotheses = (built.map,)
        self._recorder.initialized(built.map, built.views)
