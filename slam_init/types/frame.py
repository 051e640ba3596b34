"""Frames, the sources that give frames, and the tracks seen in a frame."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from slam_init.errors import SlamInitError, check_type
from slam_init.types.arrays import Floats, Image, Ints
from slam_init.types.pose import Trajectory

if TYPE_CHECKING:
    from slam_init.types.camera import Camera
    from slam_init.types.depth import Depth
    from slam_init.types.inertial import Gravity

#: A key of gtsam has 56 bits for the index of a frame, or the id of a track.
MOST_NUMBERS = 2**56


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
    depth : Depth, optional
        Depths from elsewhere: evidence about the motion of the camera.
    gravity : Gravity, optional
        Direction of gravity in the camera, by an accelerometer at rest or a robot.
    """

    index: int
    timestamp_s: float
    name: str
    image: Image
    mask: Image | None = None
    depth: Depth | None = None
    gravity: Gravity | None = None

    def __post_init__(self) -> None:
        # numpy's integers as well; a number that is none has no index.
        check_type(self.index, (int, np.integer), "the index of a frame", "an integer from 0 on")
        if not 0 <= self.index < MOST_NUMBERS:
            raise SlamInitError(f"the index of a frame is {self.index!r:.60}: give an integer from 0 on, below 2^56")

    @cached_property
    def gray(self) -> Image:
        """(H, W) uint8 luminance, in an array of its own: a caller may read the next image into the same array."""
        if self.image.ndim == 2:
            return self.image.copy()
        import cv2

        return np.asarray(cv2.cvtColor(self.image, cv2.COLOR_BGR2GRAY), np.uint8)


def check_image(image: object, size: tuple[int, int], what: str) -> None:
    """Refuse what is no image of a size: OpenCV would tell so far from the call, or take it.

    Parameters
    ----------
    image : object
        What the caller gave for one.
    size : (int, int)
        Width and height of the images of the camera.
    what : str
        The name of the image in the message.
    """
    shape, kind = getattr(image, "shape", None), getattr(image, "dtype", type(image).__name__)
    wanted = (size[1], size[0])
    if not isinstance(image, np.ndarray) or kind != np.uint8 or shape not in (wanted, (*wanted, 3)):
        raise SlamInitError(f"{what} is {kind} of the shape {shape}: give uint8, {wanted} grey or {(*wanted, 3)} BGR")


class Source(Protocol):
    """A source of frames in time order: a folder, a video, a synthetic sequence or a live stream.

    A source that knows its number of frames also has ``__len__``; see :func:`length_of`.
    """

    @property
    def name(self) -> str:
        """Short name, for reports."""
        ...

    @property
    def kind(self) -> str:
        """A layout of ``docs/datasets.md`` as ``tum``, ``video``, ``ros1``, ``live``, or a word of the user."""
        ...

    @property
    def camera(self) -> Camera | None:
        """The calibration that comes with the source, if any."""
        ...

    @property
    def groundtruth(self) -> Trajectory | None:
        """The true trajectory that comes with the source, if any."""
        ...

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Give frames in time order."""
        ...


class TimedSource(Source, Protocol):
    """A source whose length and time stamps are known without decoding its images."""

    @property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps of all frames in seconds, strictly increasing."""
        ...

    def __len__(self) -> int:
        """Number of frames. For a video the number in its header; for a bag that in its index, an upper bound."""
        ...


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
        count = len(self.track_ids) if isinstance(self.track_ids, np.ndarray) else 0
        for name, shape in (("track_ids", (count,)), ("pixels", (count, 2)), ("bearings", (count, 3))):
            value = getattr(self, name)
            if not isinstance(value, np.ndarray) or value.shape != shape:
                found = f"shape {value.shape}" if isinstance(value, np.ndarray) else f"type {type(value).__name__}"
                wanted = ", ".join(["N", *map(str, shape[1:])])
                raise SlamInitError(f"{name} of the observations has the {found}: give an array ({wanted})")
            kinds, numbers = ("iu", "integers") if name == "track_ids" else ("iuf", "numbers")
            if value.dtype.kind not in kinds:
                raise SlamInitError(f"{name} of the observations has the type {value.dtype}: give {numbers}")
        check_type(self.frame, (int, np.integer), "the frame of the observations", "its index, an integer from 0 on")
        for name in ("colors", "drifts"):
            check_type(getattr(self, name), np.ndarray, f"{name} of the observations", "an array, or leave it out")

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
        return replace(self, bearings=rays, readout_s=0.0).at(np.flatnonzero(np.isfinite(rays).all(axis=1)))

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
