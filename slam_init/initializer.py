"""The pipeline, to be read from top to bottom.

For each frame (:meth:`Initializer._step`). Each stage is timed under its name (``Result.timing_ms``):

=============  ======================================================================================================
stage          what it does
=============  ======================================================================================================
``frame``      all that follows
``track``      :mod:`slam_init.intake` checks the image and follows the tracks; one history holds their rays
``pairs``      :mod:`slam_init.frontend.keyframes` previews the pairs of the frame with earlier ones, the candidates
``evaluate``   :mod:`slam_init.decision.screening` refuses the frame if no pair shows enough tracks or motion; else
               :mod:`slam_init.decision.window_rule` evaluates the window: the pair and further views. After windows
               that were far from a map it leaves some frames out
``two_view``   inside ``evaluate``: :mod:`quest` proposes motions from the best pair
``map``        inside ``evaluate``: all views are fitted for each motion. :mod:`slam_init.window.risk` states the risk
               that the best one is wrong. :mod:`slam_init.decision.evaluated_window` names the reason, and the lens to
               go on with. :mod:`slam_init.decision.window_map` builds the map of an accepted motion, or of the two
               motions that the views do not decide between. :mod:`slam_init.decision.depths` asks whether a tracker
               can go on from its landmarks, :mod:`slam_init.decision.focal_check` whether the tracks contradict the
               stated focal length
``refine``     in place of ``pairs`` and ``evaluate`` once a map is accepted: :mod:`slam_init.decision.map_candidates`
               locates the frame in the map, which grows
=============  ======================================================================================================

A map is **accepted** if its risk is small enough and its depths are known. It is **final** when it does not
change any more: at once, or after it has grown by further frames (``Config.refine_frames``). A refusal has a reason and
its evidence. If the views cannot decide between two motions, those of a plane or those of the scene and a
large object, both maps are kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from quest.geometry.quaternion import rotation_from_vector
from slam_init.calibration.files import GivenCamera
from slam_init.config import Config
from slam_init.decision.attempt_log import AttemptLog
from slam_init.decision.current_pose import CurrentPose
from slam_init.decision.map_candidates import MapCandidates, Outcome
from slam_init.decision.screening import screen
from slam_init.errors import ConfigError, check_type
from slam_init.frontend.keyframes import KeyframeManager, PairPreview
from slam_init.frontend.matchers import Matcher
from slam_init.frontend.rolling_shutter import corrected_pixels
from slam_init.frontend.tracks import Tracker
from slam_init.intake import Intake, Turn
from slam_init.recording.recorder import Recorder
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.history import History
from slam_init.types.inertial import Gravity
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose
from slam_init.types.result import ProvisionalMap, Result
from slam_init.types.status import Status
from slam_init.types.stopwatch import Stopwatch

if TYPE_CHECKING:
    from slam_init.decision.two_views import Proposer


#: The poses of some frames (cam_from_world by the index of the frame), and the camera that was fitted with them.
FittedPoses: TypeAlias = tuple[dict[int, Pose], Camera]


class Initializer:
    """Takes frames until it has a map: images by :meth:`process`, or tracks of your own by :meth:`process_tracks`.

    Initializers share no state, so any number of them can run side by side. One of them is for one thread at a time: a
    frame that arrives from another thread while one is processed is refused. The memory of each one is bounded for a
    video of any length: the observations of the last 150 frames and of a window of candidates, the last 1000 attempts.
    Of older attempts the verdict is kept, one byte each.

    Parameters
    ----------
    camera : Camera, (3, 3) array_like or None
        The calibration of the images, or its matrix K. None: nothing is known, and the focal length is estimated. The
        size of the first image completes a matrix, and None.
    config : Config, optional
        All options; the defaults suit video and photo sets.
    recorder : Recorder, optional
        Receives a report of each frame, attempt and map.
    third_view : bool
        Whether further views join the window. Without them the window holds the pair alone; this is the method
        ``quest-two-view``.
    propose : callable, optional
        Estimates the relative pose of a pair (:data:`slam_init.decision.two_views.Proposer`); by default quest does.
    matcher : callable, optional
        Matches two images in the place of the optical flow (:class:`slam_init.frontend.matchers.Matcher`). By default
        that of ``tracking.matcher``.

    Attributes
    ----------
    status : Status
        The status after the last frame.
    """

    def __init__(
        self,
        camera: GivenCamera = None,
        config: Config | None = None,
        recorder: Recorder | None = None,
        *,
        third_view: bool = True,
        propose: Proposer | None = None,
        matcher: Matcher | None = None,
    ) -> None:
        # Imported here, since it loads the compiler (0.3 s), which reading a video or a camera does not need.
        from slam_init.decision.window_rule import WindowRule

        if not isinstance(config, Config | None) or not isinstance(recorder, Recorder | None):
            wrong = recorder if isinstance(config, Config | None) else config
            raise ConfigError(f"{type(wrong).__name__} is no option of an Initializer: give camera, Config, Recorder")
        self.config = config or Config()
        self.recorder = recorder or Recorder()
        self.stopwatch = Stopwatch()
        self.status = Status()
        self.intake = Intake(camera, self.config.tracking, matcher)
        self.keyframes = KeyframeManager(self.config)
        inputs = (self.config, self.intake.history, self.intake.shutter)
        self._new_rule = partial(WindowRule, *inputs, third_view=third_view, propose=propose)
        self._window = self._new_rule()
        self._attempts = AttemptLog()
        self._maps = MapCandidates(self.recorder, self.config)
        self._pose = CurrentPose()

    def process(
        self,
        image: Image | Frame,
        timestamp_s: float | None = None,
        *,
        mask: Image | None = None,
        gravity: Gravity | None = None,
        rotation: Floats | None = None,
        rotation_sigma_rad: float = 1e-3,
    ) -> Status:
        """Process the next frame.

        Parameters
        ----------
        image : (H, W) or (H, W, 3) uint8, or Frame
            Grey or BGR, of the size that the camera is calibrated for; or a frame of a source, which has its own index,
            name and time.
        timestamp_s : float, optional
            In seconds, for the trajectory and a rolling shutter. Without it the time of an image is its index. Stamps
            in milliseconds, microseconds or nanoseconds are recognized by size and step, converted, and reported in the
            notes of the result (:mod:`slam_init.types.time_stamps`).
        mask : (H, W) uint8 or bool, optional
            Pixels that are 0 are ignored: neither an attempt nor the map uses them. By default a frame's own mask.
        gravity : Gravity, optional
            Direction of gravity in the camera, as of an accelerometer at rest or a robot. The map states it in its
            world, and no map is accepted because of it. By default a frame's own gravity.
        rotation : (3, 3) array_like, optional
            How the camera turned since the last frame, by a gyroscope or a robot: it maps directions in the last camera
            to this one. The joint fit takes it as a measurement; without it nothing changes.
        rotation_sigma_rad : float
            Standard deviation of each component of its rotation vector. By default that of a cheap gyroscope between
            two frames of a video: 0.06 degrees.

        Returns
        -------
        Status
            Truthy once a map is accepted. While ``status.refining``, further frames are located in the map
            (``status.pose``), and it grows. Once the map is final, this method ignores frames and returns the
            last status.

        Raises
        ------
        SlamInitError
            If the array is not such an image, the gravity is none, the matrix is no rotation, or the frame is not
            later than the last one.
            The initializer has not changed then, so that the frame can be given again, or left out.
        """
        if self._maps.is_final:
            return self.status
        with self.intake.alone():
            turn = Turn.checked(rotation, rotation_sigma_rad)
            frame = self.intake.frame(image, timestamp_s, mask, gravity)
            with self.stopwatch("frame"):
                with self.stopwatch("track"):
                    current = self.intake.track(frame)
                self.recorder.frame(frame, current)
                status = self._step(current, self.tracker.revised, turn, frame.gravity)
            self.recorder.frame_time(self.stopwatch.last_ms("frame"))
        return status

    def process_tracks(
        self,
        current: Observations | ArrayLike,
        pixels: ArrayLike | None = None,
        timestamp_s: float | None = None,
        *,
        revised: Sequence[Observations] = (),
        gravity: Gravity | None = None,
        rotation: Floats | None = None,
        rotation_sigma_rad: float = 1e-3,
    ) -> Status:
        """Process the tracks of the next frame from elsewhere: from a cache, or from features and matches of your own.

        Give an initializer either images or tracks, because its tracker cannot continue tracks with other ids.

        Parameters
        ----------
        current : Observations, or (N,) int
            The tracks of the frame, or their ids. A point of the scene has the same track id in all frames, from 0 to
            2^56 - 1. The frames are in ascending order.
        pixels : (N, 2) array_like, optional
            With ids: the raw pixels of the tracks. The frame has the next index, and the camera of the initializer
            gives the rays. Tracks whose pixels have no ray are left out.
        timestamp_s : float, optional
            With ids: in seconds. Without it the time of the frame is its index.
        revised : sequence of Observations, optional
            Earlier frames with more tracks than before (see :attr:`slam_init.frontend.tracks.Tracker.revised`). Frames
            that are not in the history are ignored.
        gravity : Gravity, optional
            As for :meth:`process`.
        rotation, rotation_sigma_rad : (3, 3) array_like and float, optional
            As for :meth:`process`.

        Returns
        -------
        Status
            As for :meth:`process`.

        Raises
        ------
        SlamInitError
            If the arrays are none of tracks, a bearing is not of length 1, the bearings are not the rays of the pixels
            (as in other axes than x right, y down, z forward), the matrix is no rotation, or the frame is not later
            than the last one. The initializer has not changed then, so that the frame can be given again.
        """
        if self._maps.is_final:
            return self.status
        with self.intake.alone():
            turn = Turn.checked(rotation, rotation_sigma_rad)
            Gravity.check(gravity)
            observed = self.intake.observed(current, pixels, timestamp_s)
            observed, revised = self.intake.check_tracks(observed, revised)
            return self._step(observed, revised, turn, gravity)

    def _step(
        self,
        current: Observations,
        revised: Sequence[Observations],
        turn: Turn | None,
        gravity: Gravity | None,
    ) -> Status:
        """The way of a frame from its tracks to the status."""
        self.intake.add(current, revised, turn, gravity)
        self._maps.count(current.frame)
        if self._maps.accepted is not None:
            return self._grow(self._maps.accepted, current, revised)
        # The rays of the newest frames change in the history, since a rolling shutter is known better with each frame.
        current = self.intake.shutter.correct_newest(self.history, current.frame)
        with self.stopwatch("pairs"):
            pairs = self.keyframes.preview(self.history, current)
        with self.stopwatch("evaluate"):
            outcome = self._screen_and_evaluate(pairs, current)
        if outcome is not None:
            outcome = replace(outcome, attempt=self._attempts.add(outcome.attempt))
            self._keep(outcome, current.frame)
        self.keyframes.update(current, pairs)
        self.history.forget(keep=self.keyframes.candidates)
        # The evaluation may have changed the lens or the readout, and with them the rays of this frame.
        self.status = self._status_after(outcome, self.history[current.frame])
        return self.status

    def _screen_and_evaluate(self, pairs: list[PairPreview], current: Observations) -> Outcome | None:
        """Evaluate a frame; None where it is left out, or no pair is worth trying and no earlier motion goes on."""
        refused = screen(self.camera, self.config, current, pairs, self.intake.masked)
        if refused is not None:
            return Outcome(refused)
        chosen = self.keyframes.best_pair_to_try(pairs)
        outcome = self._window.evaluate(chosen, pairs, current, self.stopwatch)
        if chosen is not None and outcome is not None and outcome.accepted is None:
            self.keyframes.failed(chosen)
        return outcome

    def _keep(self, outcome: Outcome, frame: int) -> None:
        """Record an attempt, keep its maps, and go on with its lens."""
        self.recorder.attempt(outcome.attempt)
        if outcome.lens is not None:
            self.intake.shutter.change_lens(self.history, outcome.lens)
        if self.intake.shutter.readout_s:
            self.recorder.row_times(self.history[frame], corrected_pixels(self.camera, self.history[frame]))
        if outcome.accepted is not None:
            self.intake.check_gravity(outcome.accepted)
        self._maps.keep(outcome)

    def _status_after(self, outcome: Outcome | None, current: Observations) -> Status:
        """The status after a frame that was evaluated or left out, with the pose of its camera."""
        attempt, motion = (None, None) if outcome is None else (outcome.attempt, outcome.motion)
        pose = self._pose.update(self.history, current, motion, self.map)
        wrong_focal = self._attempts.wrong_focal
        if self.map is not None:
            known = Status.initialized(attempt)
            return replace(known, wrong_focal=wrong_focal, pose=pose, refining=not self._maps.is_final)
        if pose is not None:
            self.recorder.waiting(pose)
        self._attempts.forget_progress(keep=self.keyframes.candidates)
        return replace(self.status.after(attempt, self._attempts.best_progress, wrong_focal), pose=pose)

    def _grow(self, map_: InitialMap, current: Observations, revised: Sequence[Observations]) -> Status:
        """Locate a frame in the accepted map, which grows by it."""
        with self.stopwatch("refine"):
            located = self._maps.locate(current, revised)
        self.history.forget(keep=())  # no pair needs a candidate any more
        pose = None
        if located is not None:
            pose = self._pose.located(map_, located.keyframe, math.degrees(located.rotation_sigma_rad))
        refining, lost_at = not self._maps.is_final, self._maps.lost_at
        self.status = replace(self.status, attempt=None, pose=pose, refining=refining, lost_at=lost_at)
        return self.status

    @property
    def map(self) -> InitialMap | None:
        """The accepted map; None without one. It is replaced by the grown one where ``status.refining`` ends."""
        return self._maps.accepted

    @property
    def frames_read(self) -> int:
        """Number of frames that the initializer was given."""
        return self._maps.frames

    @property
    def tracker(self) -> Tracker:
        """Follows the tracks; it can be used after the initialization."""
        return self.intake.tracker

    @property
    def history(self) -> History:
        """The observations of the last frames; :attr:`tracker` adds to it."""
        return self.intake.history

    @property
    def camera(self) -> Camera:
        """The camera with the current lens: the stated one, or an estimate."""
        return self.history.camera

    @property
    def motion(self) -> FittedPoses | None:
        """The poses of the last evaluated window by its best motion, with their camera; None where it has no motion."""
        return self._window.motion

    @property
    def provisional(self) -> ProvisionalMap | None:
        """The map of the best motion of the last evaluated window, with its risk; the accepted map once there is one.

        It is built when it is asked for, which takes as long as a bundle adjustment. None where no motion is known.
        """
        if self.map is not None and self.map.risk is not None:
            return ProvisionalMap(self.map)
        return self._window.provisional()

    @property
    def result(self) -> Result:
        """The result up to now: the map, or the reason why there is none and the undecided maps."""
        notes, timing_ms = self.intake.notes, self.stopwatch.summary()
        return self._maps.result(self._attempts, self.history.lens.stated, notes, timing_ms)

    def finish(self) -> Result:
        """End the sequence. No map is accepted only because the sequence ends; one that grows becomes final.

        Returns
        -------
        Result
        """
        self._maps.finalize()
        self._attempts.add_free_focal(self._window.end())
        self.status = replace(self.status, refining=False, wrong_focal=self._attempts.wrong_focal)
        return self.result

    def reset(self, since: int | None = None) -> None:
        """Restart: after a map that was lost, or after a cut.

        The camera, the tracker with its tracks, the clock and an estimated readout stay. Keyframes, attempts and
        motions are forgotten, and the next map has a world frame of its own. A map that was accepted becomes a segment
        of :attr:`result`; the last 99 are kept.

        * ``since``: Absolute index of the first frame whose tracks the next map may use, among those in the history
          that the tracker has followed. By default the newest frame.
        """
        check_type(0 if since is None else since, (int, np.integer), "since", "the index of a frame")
        self._maps.restart()
        self.keyframes, self._window = KeyframeManager(self.config), self._new_rule()
        self._attempts, self._pose, self.status = AttemptLog(), CurrentPose(), Status()
        for frame in self.intake.restart(since):
            current = self.intake.shutter.correct_newest(self.history, frame)
            self._maps.count(frame)
            self.keyframes.update(current, self.keyframes.preview(self.history, current))
        self.recorder.restarted()


@cache
def load_all() -> None:
    """Load what evaluations need, and compile it on a machine's first run, so that no frame waits for it.

    A small scene of its own is initialized: 800 points two to four units before a camera that moves
    sideways.
    """
    camera = Camera("radtan", 640, 480, 500.0, 500.0, 319.5, 239.5, (0.01, 0.0, 0.0, 0.0))
    rng = np.random.default_rng(0)
    points = rng.uniform((-1.0, -0.8, 2.0), (1.0, 0.8, 4.0), (800, 3))
    initializer = Initializer(camera)
    for frame in range(8):
        turned = (points - (0.01 * frame, 0.0, 0.0)) @ rotation_from_vector(np.array([0.0, 0.01 * frame, 0.0])).T
        pixels = camera.project(turned) + 0.3 * rng.normal(size=(len(points), 2))
        # Tracks drift by a random walk: 0.02 px^2 a frame in each coordinate, with a correlation of one half.
        drifts = np.tile(0.01 * frame * np.array([[2.0, 1.0], [1.0, 2.0]]), (len(points), 1, 1))
        seen = np.flatnonzero(np.isfinite(pixels).all(axis=1))
        rays = camera.bearings(pixels[seen])
        observed = Observations(frame, frame / 30, "", seen, pixels[seen], rays, drifts=drifts[seen])
        if initializer.process_tracks(observed):
            return
