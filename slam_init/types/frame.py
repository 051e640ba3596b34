"""Frames, the sources that give frames, and the tracks seen in a frame."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from slam_init.errors import SlamInitError, check_type
from slam_init.types.arrays import Floats, Image, Ints, as_array, as_number, set_fields
from slam_init.types.camera import Camera
from slam_init.types.inertial import Gravity
from slam_init.types.pose import Trajectory

#: A key of gtsam has 56 bits for the index of a frame, or the id of a track.
MOST_NUMBERS = 2**56
#: What to do about images of another size than that of their calibration.
_REMEDY = (
    "if they are resized, give camera.scaled(FACTOR); if they are cropped, give a Camera of their size, with the "
    "corner of the crop subtracted from cx and cy"
)


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a source.

    Attributes
    ----------
    index : int
        Absolute position in the source, from 0; it does not depend on ``--start``.
    timestamp_s : float
        Time stamp of the source in seconds.
    name : str
        File name relative to the source's image folder, or ``frame-000012`` for videos.
    image : (H, W) or (H, W, 3) uint8
        Grey or BGR, as stored.
    mask : (H, W) uint8, optional
        Pixels that are 0 are ignored: no track begins in them or enters them.
    gravity : Gravity, optional
        Direction of gravity in the camera, by an accelerometer at rest or a robot.
    """

    index: int
    timestamp_s: float
    name: str
    image: Image
    mask: Image | None = None
    gravity: Gravity | None = None

    def __post_init__(self) -> None:
        check_type(self.index, (int, np.integer), "the index of a frame", "an integer from 0 on")
        if not 0 <= self.index < MOST_NUMBERS:
            raise SlamInitError(f"the index of a frame is {self.index!r:.60}: give an integer from 0 on, below 2^56")
        what = f"frame {self.index}"
        check_type(self.name, str, f"the name of {what}", "text")
        Gravity.check(self.gravity)
        image = as_image(self.image, f"the image of {what}")
        set_fields(
            self,
            index=int(self.index),  # an integer of 8 bits would overflow
            timestamp_s=as_number(self.timestamp_s, f"the time stamp of {what}", "finite seconds"),
            image=image,
            mask=None if self.mask is None else _as_mask(self.mask, f"the mask of {what}", image.shape[:2]),
        )

    @cached_property
    def gray(self) -> Image:
        """(H, W) uint8 luminance, in an array of its own: a caller may read the next image into the same array."""
        if self.image.ndim == 2:
            return self.image.copy()
        import cv2

        return np.asarray(cv2.cvtColor(self.image, cv2.COLOR_BGR2GRAY), np.uint8)


def as_image(image: object, what: str, size: tuple[int, int] | None = None) -> Image:
    """Make an image of what a caller gave, or state in one line why it is none: OpenCV would report it late.

    Parameters
    ----------
    image : object
        What the caller gave for one.
    what : str
        The name of the image in the message.
    size : (int, int), optional
        Width and height of the images of the camera.

    Returns
    -------
    (H, W) or (H, W, 3) uint8
    """
    shape = np.shape(image) if isinstance(image, np.ndarray) else ()
    wanted = "(H, W)" if size is None else f"({size[1]}, {size[0]})"
    give = f"uint8, {wanted} grey or {wanted[:-1]}, 3) BGR"
    if len(shape) not in (2, 3) or shape[2:] not in ((), (3,)) or 0 in shape:
        found = f"shape {shape}" if shape else f"type {type(image).__name__}"
        raise SlamInitError(f"{what} has the {found}: give {give}")
    array = as_array(image, np.uint8, shape, what, give)
    if size is not None and shape[1::-1] != size:
        raise SlamInitError(f"{what} is {shape[1]}x{shape[0]}, but the camera is for {size[0]}x{size[1]}: {_REMEDY}")
    return array


def _as_mask(mask: object, what: str, shape: tuple[int, ...]) -> Image:
    """Make a mask of what a caller gave, or state in one line why it is none of an image."""
    height, width = shape
    give = f"uint8 or bool, ({height}, {width}), the size of the image; 0 is ignored"
    values = mask.astype(np.uint8) if isinstance(mask, np.ndarray) and mask.dtype == np.bool_ else mask
    return as_array(values, np.uint8, (height, width), what, give)


class Source(Protocol):
    """A source of frames in time order: a folder, a video, a synthetic sequence or a live stream.

    A source that knows its number of frames also has ``__len__``; see :func:`length_of`.
    """

    @property
    def name(self) -> str:
        """Short name, for reports."""

    @property
    def kind(self) -> str:
        """A layout of ``docs/how-to/data-sets.md`` as ``tum``, ``video``, ``ros1``, ``live``, or a word of the user."""

    @property
    def camera(self) -> Camera | None:
        """The calibration that comes with the source, if any."""

    @property
    def groundtruth(self) -> Trajectory | None:
        """The true trajectory that comes with the source, if any."""

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Give frames in time order."""


class TimedSource(Source, Protocol):
    """A source whose length and time stamps are known without decoding its images."""

    @property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps of all frames in seconds, strictly increasing."""

    def __len__(self) -> int:
        """Number of frames. For a video the number in its header; for a bag that in its index, an upper bound."""


def length_of(source: Source) -> int | None:
    """Tell how many frames a source has.

    * Returns: For a video, the number in its header. None for a live stream, whose end is not known.
    """
    return len(source) if isinstance(source, Sized) else None


def notes_of(source: Source) -> tuple[str, ...]:
    """List what the user should know about a source.

    * ``source``: The attribute ``notes`` is optional, because a data set of the user need not have any.
    """
    return tuple(getattr(source, "notes", ()))


@dataclass(frozen=True, eq=False)
class Observations:
    """The tracks that are seen in one frame.

    Attributes
    ----------
    frame : int
        Absolute index of the frame.
    timestamp_s : float
    name : str
        Name of the image.
    track_ids : (N,) int
        From 0 to 2^56 - 1, strictly increasing, so that the common tracks of two frames are a sorted intersection.
    pixels : (N, 2) float
        Measured positions in the raw image.
    bearings : (N, 3) float
        Unit rays of the pixels in the camera frame, without distortion, at the middle of the readout.
    colors : (N, 3) uint8
        RGB of the image at the pixels; (0, 3) if unknown.
    turn_rad_s : (3,) float or None
        How the rays of points at rest turn in the camera frame: a rotation vector per second, which is the negative
        angular velocity of the camera. None where it is not known, or where no rolling shutter is assumed.
    turn_error : float
        Relative standard deviation of ``turn_rad_s``, where it is known.
    readout_s : float
        Readout of the image that the bearings are corrected for; 0 where they are not.
    drifts : (N, 2, 2) float
        Covariance of how far each track has drifted from its point since it began, px^2; (0, 2, 2) where tracks do not
        drift.
    step_px : float
        Standard deviation of the last step of a typical track; 0 where flow followed none.
    exposure_s : float
        Exposure time by the trails of blurred images; 0 where there are none.
    """

    frame: int
    timestamp_s: float
    name: str
    track_ids: Ints
    pixels: Floats
    bearings: Floats
    colors: Image = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    turn_rad_s: Floats | None = None
    turn_error: float = 0.0
    readout_s: float = 0.0
    drifts: Floats = field(default_factory=lambda: np.zeros((0, 2, 2)))
    step_px: float = 0.0
    exposure_s: float = 0.0

    def __post_init__(self) -> None:
        check_type(self.frame, (int, np.integer), "the frame of the observations", "its index, an integer from 0 on")
        check_type(self.name, str, f"the name of frame {self.frame}", "text")
        what = f"of frame {self.frame}"
        ids = as_array(self.track_ids, np.int64, (None,), f"track_ids {what}")
        set_fields(
            self,
            frame=int(self.frame),
            timestamp_s=as_number(self.timestamp_s, f"the time stamp {what}", "finite seconds"),
            track_ids=ids,
            pixels=as_array(self.pixels, np.float64, (len(ids), 2), f"pixels {what}"),
            bearings=as_array(self.bearings, np.float64, (len(ids), 3), f"bearings {what}"),
            colors=as_array(self.colors, np.uint8, (None, 3), f"colors {what}"),
            drifts=as_array(self.drifts, np.float64, (None, 2, 2), f"drifts {what}"),
            readout_s=as_number(self.readout_s, f"readout_s {what}", "a finite number"),
        )
        if self.turn_rad_s is not None:
            set_fields(self, turn_rad_s=as_array(self.turn_rad_s, np.float64, (3,), f"turn_rad_s {what}"))
        for name in ("colors", "drifts"):
            if len(getattr(self, name)) not in (0, len(ids)):
                raise SlamInitError(f"{name} {what} are not of {len(ids)} tracks: give one for each, or none")
        for name in ("turn_error", "step_px", "exposure_s"):
            number = as_number(getattr(self, name), f"{name} {what}", "a finite number")
            if number < 0:
                raise SlamInitError(f"{name} {what} is negative: give a number from 0 on")
            set_fields(self, **{name: number})
        if (np.diagonal(self.drifts, axis1=1, axis2=2) < 0).any():
            raise SlamInitError(f"drifts {what} must be covariances: give variances from 0 on")
        if not (ids[1:] > ids[:-1]).all():
            raise SlamInitError(f"track_ids {what} must be strictly increasing: sort them, and give each once")

    def __len__(self) -> int:
        return len(self.track_ids)

    def through(self, camera: Camera) -> Observations:
        """The same tracks with the rays of another lens, not corrected for a rolling shutter.

        Parameters
        ----------
        camera : Camera

        Returns
        -------
        Observations
            Without the tracks whose pixels have no ray.
        """
        rays = camera.bearings(self.pixels)
        seen = np.flatnonzero(np.isfinite(rays).all(axis=1))
        return replace(self.at(seen), bearings=rays[seen], readout_s=0.0)

    def at(self, positions: Ints) -> Observations:
        """Some of the tracks.

        Parameters
        ----------
        positions : (M,) int
            Positions of the tracks, in ascending order.

        Returns
        -------
        Observations
        """
        return replace(
            self,
            track_ids=self.track_ids[positions],
            pixels=self.pixels[positions],
            bearings=self.bearings[positions],
            colors=self.colors[positions] if len(self.colors) else self.colors,
            drifts=self.drifts[positions] if len(self.drifts) else self.drifts,
        )
