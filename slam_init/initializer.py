"""The pipeline, to be read from top to bottom.

For each frame, the tracker follows the tracks, and the keyframe manager previews the pairs with earlier frames. If no
pair shows enough tracks or motion, the frame is refused (:func:`~slam_init.decision.screening.screen`). Otherwise the
window judges the frame (:mod:`slam_init.decision.window_rule`), in these stages:

==========================  =========================================================================================
stage                       what it does
==========================  =========================================================================================
two views                   :mod:`quest` proposes motions from the best pair that need not wait
window                      one joint fit of all views for each motion (:mod:`slam_init.window`)
risk                        the probability that the best motion is wrong
map                         a bundle-adjusted map of an accepted motion, or of both motions of an undecided plane
depths                      whether a tracker can go on from the landmarks (:mod:`slam_init.decision.depths`)
==========================  =========================================================================================

The first map whose risk is small enough, and whose depths are known, ends the initialization. A refusal has a reason
and its evidence. If the views cannot decide between the two motions of a plane, both maps are kept.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from threading import get_ident
from typing import TYPE_CHECKING

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.calibration.choosing import GivenCamera, camera_of_size, check_given
from slam_init.calibration.prior import prior_camera
from slam_init.config import Config
from slam_init.decision.attempt_log import AttemptLog, focal_notes
from slam_init.decision.focal_check import FocalCheck
from slam_init.decision.maps_so_far import MapsSoFar
from slam_init.decision.pose_so_far import PoseSoFar
from slam_init.decision.screening import screen
from slam_init.errors import ConfigError, SlamInitError
from slam_init.frontend.conventions import check_rays
from slam_init.frontend.frame_clock import FrameClock
from slam_init.frontend.keyframes import KeyframeManager, PairPreview
from slam_init.frontend.rolling_shutter import RollingShutter, corrected_pixels
from slam_init.frontend.static_overlay import StaticOverlay
from slam_init.frontend.tracks import Tracker
from slam_init.recording.recorder import Recorder
from slam_init.types.arrays import Floats, Image
from slam_init.types.attitude import checked_rotation
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.initial_map import InitialMap
from slam_init.types.result import Attempt, ProvisionalMap, Result, Segment
from slam_init.types.segments import MAX_SEGMENTS
from slam_init.types.status import Status, frame_of
from slam_init.types.stopwatch import Stopwatch

if TYPE_CHECKING:
    from slam_init.decision.two_views import Proposer
    from slam_init.decision.window_rule import WindowRule


class Initializer:
    """Takes frames until it has a map: images by :meth:`process`, or tracks of your own by :meth:`process_tracks`.

    Initializers share no state, so any number of them can run side by side. One of them is for one thread at a time: a
    frame that arrives from another thread while one is processed is refused. The memory of each one is bounded for a
    video of any length: the observations of the last 150 frames and of a window of candidates, the last 1000 attempts,
    and two dozen bytes a frame for statistics.

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
    shutter : RollingShutter
        Corrects the rays of a rolling shutter.
    """

    def __init__(
        self,
        camera: GivenCamera = None,
        config: Config | None = None,
        recorder: Recorder | None = None,
        *,
        third_view: bool = True,
        propose: Proposer | None = None,
    ) -> None:
        check_given(camera)
        if not isinstance(config, Config | None) or not isinstance(recorder, Recorder | None):
            wrong = recorder if isinstance(config, Config | None) else config
            raise ConfigError(f"{type(wrong).__name__} is no option of an Initializer: give camera, Config, Recorder")
        self.config = config or Config()
        self.recorder = recorder or Recorder()
        # Until the first frame tells the size of the images, a camera that is not given in full has an ordinary one.
        self._given, self._waits_for_size = camera, not isinstance(camera, Camera)
        self._begin(camera if isinstance(camera, Camera) else prior_camera((640, 480)))
        self._overlay = StaticOverlay()
        self.stopwatch = Stopwatch()
        self.status = Status()
        self.frames_read = 0
        self._third_view = third_view
        self._propose = propose
        self._next_index = 0
        self._first_index: int | None = None
        self._segments: deque[Segment] = deque(maxlen=MAX_SEGMENTS)
        self._attempts = AttemptLog()
        self._maps, self._pose = MapsSoFar(self.recorder, self.config), PoseSoFar()
        self._window: WindowRule | None = None
        self._masked = 0.0
        self._thread: int | None = None

    def process(
        self,
        image: Image | Frame,
        timestamp_s: float | None = None,
        *,
        mask: Image | None = None,
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
            in milliseconds, microseconds or nanoseconds are recognized by size and step, converted, and told in the
            notes of the result (:mod:`slam_init.types.time_stamps`).
        mask : (H, W) uint8 or bool, optional
            Pixels that are 0 are ignored: neither an attempt nor the map uses them. By default a frame's own mask.
        rotation : (3, 3) array_like, optional
            How the camera turned since the last frame, by a gyroscope or a robot: it maps directions in the last camera
            to this one. The joint fit takes it as a measurement; without it nothing changes.
        rotation_sigma_rad : float
            Standard deviation of each component of its rotation vector. By default that of a cheap gyroscope between
            two frames of a video: 0.06 degrees.

        Returns
        -------
        Status
            Truthy once there is a map. While ``status.refining``, further frames are located in it
            (``status.pose``), and it grows; from then on this method ignores frames.

        Raises
        ------
        SlamInitError
            If the array is not such an image, the matrix is no rotation, or the frame is not later than the last one.
            The initializer has not changed then, so that the frame can be left out.
        """
        if self._maps.handed_over:
            return self.status
        with self._alone():
            return self._process(image, timestamp_s, mask, rotation, rotation_sigma_rad)

    def _process(
        self,
        image: Image | Frame,
        timestamp_s: float | None,
        mask: Image | None,
        rotation: Floats | None,
        rotation_sigma_rad: float,
    ) -> Status:
        if self._waits_for_size:
            self._settle_camera(image)
        frame = frame_of(image, timestamp_s, self._next_index, self.camera, mask)
        turned = None if rotation is None else (checked_rotation(rotation, rotation_sigma_rad), rotation_sigma_rad)
        own_seconds = timestamp_s is None or isinstance(image, Frame)
        frame = self._clock.stamped(frame, in_seconds_by_type=own_seconds)
        with self.stopwatch("frame"):
            self._masked = 0.0 if frame.mask is None else 1.0 - np.count_nonzero(frame.mask) / frame.mask.size
            with self.stopwatch("track"):
                current = self.tracker.track(frame)
                self._overlay.observe(frame, current)
            self.recorder.frame(frame, current)
            status = self._step(current, turned=turned)
        self.recorder.frame_time(self.stopwatch.last_ms("frame"))
        return status

    def process_tracks(
        self,
        current: Observations,
        revised: Sequence[Observations] = (),
        *,
        rotation: Floats | None = None,
        rotation_sigma_rad: float = 1e-3,
    ) -> Status:
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
        rotation, rotation_sigma_rad : (3, 3) array_like and float, optional
            As for :meth:`process`.

        Returns
        -------
        Status
            As for :meth:`process`.

        Raises
        ------
        SlamInitError
            If the shapes of the arrays do not fit together, a bearing is not finite or not of length 1, the bearings
            are not the rays of the pixels (as in other axes than x right, y down, z forward), the matrix is no
            rotation, or the frame is not later than the last one. The initializer has not changed then.
        """
        if self._maps.handed_over:
            return self.status
        if self._waits_for_size:
            raise SlamInitError("tracks tell no size of the images: give the Initializer a Camera (Camera.from_K)")
        if self.camera.focal_sigma is not None:  # their rays are of a lens that is being estimated
            current, revised = current.through(self.camera), [one.through(self.camera) for one in revised]
        self._clock.check_tracks(current)
        check_rays(self.camera, current)
        turned = None if rotation is None else (checked_rotation(rotation, rotation_sigma_rad), rotation_sigma_rad)
        with self._alone():
            return self._step(current, revised, turned)

    def _step(
        self,
        current: Observations,
        revised: Sequence[Observations] = (),
        turned: tuple[Floats, float] | None = None,
    ) -> Status:
        """Process the tracks of the next frame, whose time is checked."""
        self.history.add(current, revised)
        self._clock.took(current)
        if turned is not None:
            self.history.turned(current.frame, *turned)
        if self.map is not None:
            return self._refine(self.map, current)
        current = self.shutter.correct(self.history, current.frame)
        self._count(current)
        with self.stopwatch("pairs"):
            pairs = self.keyframes.preview(self.history, current)
        with self.stopwatch("judge"):
            attempt = self._judge(pairs, current)
        self.keyframes.update(current, pairs)
        self.history.forget(keep=self.keyframes.candidates)
        judged = self._window is not None and attempt is not None and attempt.window is not None
        window = self._window.newest_motion() if judged and self._window is not None else None
        pose = self._pose.after(self.history, current, window, self.map)
        if pose is not None and self.map is None:
            self.recorder.waiting(pose)
        self.status = replace(self._status_after(attempt), pose=pose)
        return self.status

    def _refine(self, map_: InitialMap, current: Observations) -> Status:
        """Locate a frame in the accepted map, which grows by it."""
        self._count(current)
        with self.stopwatch("refine"):
            located = self._maps.locate(current)
        self.history.forget(keep=())
        pose = None if located is None else self._pose.located(map_, located.keyframe, located.rotation_sigma_deg)
        self.status = replace(
            self.status, attempt=None, pose=pose, refining=not self._maps.handed_over, lost_at=self._maps.lost_at
        )
        return self.status

    @property
    def map(self) -> InitialMap | None:
        """The accepted map; None without one. It is replaced by the grown one where ``status.refining`` ends."""
        return self._maps.accepted

    @property
    def provisional(self) -> ProvisionalMap | None:
        """The best map up to now with its risk; the accepted map once there is one.

        It is built when it is asked for, which takes as long as a bundle adjustment. None where no motion is known.
        """
        if self._window is None:
            return None
        if self.map is not None and self.status.risk is not None:
            return ProvisionalMap(self.map, self.status.risk)
        return self._window.provisional()

    @property
    def result(self) -> Result:
        """The result up to now: the map, or the reason why there is none and the undecided maps."""
        reason = None if self.map is not None else self._attempts.prevailing_reason()
        return Result(
            map=self.map,
            reason=reason,
            frames_read=self.frames_read,
            frames_to_init=self.frames_read - self._maps.refined if self.map is not None else None,
            attempts=self._attempts.kept,
            timing_ms=self.stopwatch.summary(),
            notes=self._notes(),
            advice="" if reason is None else self._attempts.advice(reason),
            hypotheses=self._maps.hypotheses,
            margin=self._maps.margin,
            segments=(*self._segments, *self._current_segment()) if self._segments else (),
            camera=self.camera,
            method=self.config.method,
            seed=self.config.seed,
        )

    def finish(self) -> Result:
        """End the sequence. No map is accepted only because the sequence ends; one that grows is handed over.

        Returns
        -------
        Result
        """
        self._maps.hand_over()
        self.status = replace(self.status, refining=False)
        return self.result

    def reset(self, since: int | None = None) -> None:
        """Start anew: after a map that was lost, or after a cut.

        The camera, the tracker with its tracks, the clock and an estimated readout stay. Keyframes, attempts and
        motions are forgotten, and the next map has a world frame of its own. A map that was accepted becomes a segment
        of :attr:`result`; the last 99 are kept.

        Parameters
        ----------
        since : int, optional
            Absolute index of the first frame whose tracks the next map may use, among those in the history that the
            tracker has followed. By default the newest frame.
        """
        self._segments.extend(self._current_segment())
        known = [observed.frame for observed in self.history]
        newest = known[-1:] or [0]
        self.history.start_at(newest[0] if since is None else min(since, newest[0]))
        self.keyframes = KeyframeManager(self.camera, self.config)
        self._focal_check = FocalCheck(self.camera, self.config)
        self._attempts, self._maps, self._pose = AttemptLog(), MapsSoFar(self.recorder, self.config), PoseSoFar()
        self._window = None
        self.status, self.frames_read, self._first_index = Status(), 0, None
        for observed in list(self.history):
            self._clock.took(observed)
            current = self.shutter.correct(self.history, observed.frame)
            self._count(current)
            self.keyframes.update(current, self.keyframes.preview(self.history, current))
        self.recorder.restarted()

    # -- parts of the step of a frame -------------------------------------------------------------

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Refuse a frame while another thread is inside: the history would be that of both."""
        inside, thread = self._thread, get_ident()
        if inside is not None and inside != thread:
            raise SlamInitError("another thread is processing a frame: an Initializer is for one thread at a time")
        self._thread = thread
        try:
            yield
        finally:
            self._thread = inside

    def _begin(self, camera: Camera) -> None:
        """Make what depends on the camera."""
        self.camera = camera
        self.tracker = Tracker(camera, self.config.tracking)
        self.history = self.tracker.history
        self._clock = FrameClock(self.history)
        self.shutter = RollingShutter(camera)
        self.keyframes = KeyframeManager(camera, self.config)
        self._focal_check = FocalCheck(camera, self.config)

    def _settle_camera(self, image: Image | Frame) -> None:
        """Complete the given camera with the size of the first image."""
        pixels = image.image if isinstance(image, Frame) else image
        shape: tuple[int, ...] = getattr(pixels, "shape", ())
        if len(shape) >= 2 and min(shape[:2]) > 0:  # what is no image is refused next
            self._begin(camera_of_size(self._given, (shape[1], shape[0])))
            self._waits_for_size = False

    def _count(self, current: Observations) -> None:
        self.frames_read += 1
        self._next_index = current.frame + 1
        self._first_index = current.frame if self._first_index is None else self._first_index

    def _current_segment(self) -> tuple[Segment, ...]:
        """The accepted map as a segment; empty without one."""
        if self.map is None or self._first_index is None:
            return ()
        return (Segment(self.map, self._first_index, self.frames_read - self._maps.refined),)

    def _status_after(self, attempt: Attempt | None) -> Status:
        if self.map is not None:
            return replace(Status.initialized(attempt), refining=not self._maps.handed_over)
        return self.status.after(attempt, self._attempts.best_progress(self.keyframes.candidates))

    def _judge(self, pairs: list[PairPreview], current: Observations) -> Attempt | None:
        """Judge a frame; the attempt, if it makes one."""
        refused = screen(self.camera, self.config, current, pairs, self._masked)
        if refused is not None:
            return self._checked_and_logged(refused, pairs, current)
        best = self.keyframes.best_pair_to_try(pairs)
        outcome = self._window_rule().judge(best, pairs, current, self.stopwatch)
        if outcome is None:
            return None
        attempt = self._checked_and_logged(outcome.attempt, pairs, current)
        if self._window is not None and self._window.follow_lens():
            self._see_through(self._window.lens.camera)
        self._report_shutter(current.frame)
        self._maps.take(outcome)
        if self.map is None and best is not None:
            self.keyframes.failed(best)
        return attempt

    def _window_rule(self) -> WindowRule:
        if self._window is None:
            # Imported here, since it loads the compiler (0.3 s), as quest does where an estimation starts.
            from slam_init.decision.window_rule import WindowRule

            self._window = WindowRule(
                self.camera, self.config, self.history, self.shutter, third_view=self._third_view, propose=self._propose
            )
        return self._window

    def _see_through(self, camera: Camera) -> None:
        """Go on with another estimate of the lens; the window has taken the rays of the history from it."""
        self.camera = camera
        self.tracker.adopt_camera(camera)
        self.keyframes.camera = camera

    def _notes(self) -> tuple[str, ...]:
        """All notes for the user."""
        focal = focal_notes(self.map, self.config.map)
        lost = () if self._maps.lost_at is None else (f"the map was lost at frame {self._maps.lost_at}, while it grew",)
        return (
            *self._clock.notes,
            *self._attempts.notes(),
            *focal,
            *self._shutter_notes(),
            *self._overlay.notes,
            *lost,
        )

    def _shutter_notes(self) -> tuple[str, ...]:
        """A note about an estimated readout, for people who know their camera."""
        if self.camera.readout_s is not None or not self.shutter.readout_s:
            return ()
        found = self.camera.with_readout(self.shutter.readout_s)
        return (f"a rolling shutter was corrected: readout {found.readout_ms:.1f} ms, {found.readout_direction}",)

    def _report_shutter(self, frame: int) -> None:
        """Report what the correction of a rolling shutter moves, where it is known."""
        if self.shutter.readout_s and frame in self.history:
            corrected = self.history[frame]
            self.recorder.row_times(corrected, corrected_pixels(self.camera, corrected))

    def _checked_and_logged(self, attempt: Attempt, pairs: Sequence[PairPreview], current: Observations) -> Attempt:
        """Add a check of the focal length to an attempt if one is due, and log the attempt."""
        if self.camera.focal_sigma is None:  # a focal length that is no calibration needs no suspicion
            attempt = self._focal_check(attempt, pairs, self.history, current)
        self.recorder.attempt(attempt)
        self._attempts.add(attempt)
        return attempt


@cache
def load_all() -> None:
    """Load what judgements need, and compile it on a machine's first run, so that no frame waits for it.

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
        drifts = np.full((len(points), 2, 2), 0.01 * frame) + 0.01 * frame * np.eye(2)
        seen = np.flatnonzero(np.isfinite(pixels).all(axis=1))
        observed = Observations(
            frame=frame,
            timestamp_s=frame / 30,
            name="",
            track_ids=seen,
            pixels=pixels[seen],
            bearings=camera.bearings(pixels[seen]),
            drifts=drifts[seen],
        )
        if initializer.process_tracks(observed):
            return
