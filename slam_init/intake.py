"""What an initializer takes in: images are tracked, tracks of others are checked, and one history holds their rays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from threading import get_ident
from typing import NamedTuple

import numpy as np

from slam_init.calibration.files import GivenCamera, camera_of_size, check_given, prior_camera
from slam_init.config import TrackingConfig
from slam_init.errors import SlamInitError, check_type
from slam_init.frontend.checks import FrameClock, check_pixels, check_rays
from slam_init.frontend.matched_tracks import make_tracker
from slam_init.frontend.matchers import Matcher
from slam_init.frontend.picture_check import PictureCheck
from slam_init.frontend.rolling_shutter import RollingShutter
from slam_init.types.arrays import Floats, Image, as_array
from slam_init.types.camera import Camera
from slam_init.types.frame import MOST_NUMBERS, Frame, Observations
from slam_init.types.inertial import Gravity, checked_rotation
from slam_init.types.initial_map import InitialMap
from slam_init.types.lens import CurrentLens
from slam_init.types.status import frame_of


class Turn(NamedTuple):
    """How the camera turned since the last frame, by a gyroscope or a robot."""

    rotation: Floats
    sigma_rad: float

    @staticmethod
    def checked(rotation: Floats | None, sigma_rad: float) -> Turn | None:
        """A measurement; None without one. Raises SlamInitError if the matrix is no rotation."""
        return None if rotation is None else Turn(checked_rotation(rotation, sigma_rad), float(sigma_rad))


class Intake:
    """Takes images and tracks. What is wrong with them is reported before anything changes.

    * ``given``: The calibration of the images, or its matrix K, or None. The size of the first image completes a
      matrix, and None.
    * ``tracker``: Follows the tracks of images.
    * ``history``: The observations of the last frames. It knows the current lens.
    * ``shutter``: Corrects the rays of a rolling shutter.
    * ``masked``: Share of the last image that a mask ignores.
    """

    def __init__(self, given: GivenCamera, config: TrackingConfig, matcher: Matcher | None = None) -> None:
        check_given(given)
        # Until the first frame shows the size of the images, a camera that is not given in full has an ordinary one.
        self._given, self._waits_for_size = given, not isinstance(given, Camera)
        camera = given if isinstance(given, Camera) else prior_camera((640, 480))
        self.tracker = make_tracker(camera, config, matcher)
        self.history = self.tracker.history
        self.shutter = RollingShutter(self.history.camera)
        self.masked = 0.0
        self._clock, self._pictures = FrameClock(self.history), PictureCheck()
        self._thread: int | None = None
        self._source = ""
        self._gravity_contradicts = False

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Refuse a frame while another thread is inside: the history would be that of both."""
        inside, thread = self._thread, get_ident()
        if inside is not None and inside != thread:
            raise SlamInitError("another thread is processing a frame: an Initializer is for one thread at a time")
        self._thread = thread
        try:
            yield
        finally:
            self._thread = inside

    def frame(
        self,
        image: Image | Frame,
        timestamp_s: float | None,
        mask: Image | None,
        gravity: Gravity | None = None,
    ) -> Frame:
        """Check an image, its time, its mask and its gravity, and make a frame of them."""
        self._check_source("images")
        lens = self._completed_lens(image) if self._waits_for_size else self.history.lens
        frame = frame_of(image, timestamp_s, self.history.newest + 1, lens.camera, mask)
        if gravity is not None:
            frame = replace(frame, gravity=gravity)
        if frame.index <= self.history.newest:
            raise SlamInitError(
                f"frame {frame.index} is given after frame {self.history.newest}: feed frames in ascending order"
            )
        own_seconds = timestamp_s is None or isinstance(image, Frame)
        stamped = self._clock.stamped(frame, in_seconds_by_type=own_seconds)
        # What was refused until here has changed nothing.
        if self._waits_for_size:
            self.history.lens, self._waits_for_size = lens, False
        return stamped

    def track(self, frame: Frame) -> Observations:
        """Follow the tracks into a frame."""
        try:
            current = self.tracker.track(frame)
        except BaseException:  # of a matcher: the frame may be tried again
            self._clock.give_back()
            raise
        self._source = "images"
        self.masked = 0.0 if frame.mask is None else 1.0 - np.count_nonzero(frame.mask) / frame.mask.size
        self._pictures.observe(frame, current)
        return current

    def observed(self, tracks: object, pixels: object, timestamp_s: float | None) -> Observations:
        """Check tracks from elsewhere: observations, or the ids and the pixels of the next frame."""
        self._check_source("tracks")
        if self._waits_for_size:
            raise SlamInitError("tracks state no size of the images: give the Initializer a Camera (Camera.from_K)")
        if isinstance(tracks, Observations) and pixels is None and timestamp_s is None:
            return tracks
        if isinstance(tracks, Observations) or pixels is None:
            raise SlamInitError(
                f"tracks of the type {type(tracks).__name__}: give slam_init.Observations alone, or ids with pixels"
            )
        index, camera = self.history.newest + 1, self.history.camera
        ids = as_array(tracks, np.int64, (None,), f"track_ids of frame {index}")
        points = as_array(pixels, np.float64, (len(ids), 2), f"pixels of frame {index}")
        check_pixels(camera, index, points)
        time_s, order = float(index) if timestamp_s is None else timestamp_s, np.argsort(ids, kind="stable")
        ahead = np.tile([0.0, 0.0, 1.0], (len(ids), 1))
        return Observations(index, time_s, f"frame-{index:06d}", ids[order], points[order], ahead).through(camera)

    def check_tracks(
        self, current: Observations, revised: Sequence[Observations]
    ) -> tuple[Observations, Sequence[Observations]]:
        """Check the time and the rays of tracks from elsewhere; return them with the rays of the current lens."""
        check_type(revised, (list, tuple), "revised", "a list of Observations of earlier frames")
        for one in revised:
            check_type(one, Observations, "one of the revised frames", "slam_init.Observations")
        for one in (current, *revised):
            if one.frame >= MOST_NUMBERS or ((one.track_ids < 0) | (one.track_ids >= MOST_NUMBERS)).any():
                raise SlamInitError(
                    f"frame {one.frame}: its index and its track ids must be from 0 to 2^56 - 1: renumber"
                )
        camera = self.history.camera
        if camera.focal_sigma is not None:  # their rays are of a lens that is being estimated
            current, revised = current.through(camera), [one.through(camera) for one in revised]
        self._clock.check_tracks(current)
        for one in (current, *revised):
            check_rays(camera, one)
        return current, revised

    def _check_source(self, source: str) -> None:
        """Refuse images after tracks, and tracks after images: their tracks have other ids."""
        if self._source not in ("", source):
            raise SlamInitError(f"{source} after {self._source}: give an Initializer either images or tracks")

    def add(
        self,
        current: Observations,
        revised: Sequence[Observations],
        turn: Turn | None,
        gravity: Gravity | None = None,
    ) -> None:
        """Add the tracks of the next frame to the history."""
        self.history.add(current, revised)  # the tracker has put those of an image there already
        self._source = self._source or "tracks"
        if gravity is not None:
            self.history.gravities[current.frame] = gravity
        self._clock.took(current)
        if turn is not None:
            self.history.turned(current.frame, *turn)

    def check_gravity(self, map_: InitialMap) -> None:
        """Note whether the gravity of the frames fits the rotations of a map."""
        given = any(keyframe.frame in self.history.gravities for keyframe in map_.keyframes)
        self._gravity_contradicts = given and map_.gravity is None

    def restart(self, since: int | None) -> list[int]:
        """Forget the frames before one, by default before the newest; return those that stay."""
        newest = max(self.history.newest, 0)
        self.history.start_at(newest if since is None else min(since, newest))
        return [observed.frame for observed in self.history]

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes about the time stamps, an estimated readout, and what is in the image and not in the scene."""
        note = "gravity is left out: its directions in the frames contradict the rotations of the map"
        gravity = (note,) if self._gravity_contradicts else ()
        return (*self._clock.notes, *self._shutter_notes(), *self._pictures.notes, *gravity)

    def _completed_lens(self, image: Image | Frame) -> CurrentLens:
        """The lens of the given camera with the size of the first image; what is no image is refused by its frame."""
        pixels = image.image if isinstance(image, Frame) else image
        shape: tuple[int, ...] = getattr(pixels, "shape", ())
        if len(shape) < 2 or min(shape[:2]) <= 0:
            return self.history.lens
        return CurrentLens.of(camera_of_size(self._given, (shape[1], shape[0])))

    def _shutter_notes(self) -> tuple[str, ...]:
        """A note about an estimated readout, for people who know their camera."""
        if self.history.camera.readout_s is not None or not self.shutter.readout_s:
            return ()
        found = self.history.camera.with_readout(self.shutter.readout_s)
        return (f"a rolling shutter was corrected: readout {found.readout_ms:.1f} ms, {found.readout_direction}",)
