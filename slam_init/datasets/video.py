"""Video files, through OpenCV."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from slam_init.datasets.image_files import MAX_FRAMES, MAX_PIXELS, check_size, frame_range
from slam_init.errors import SourceError
from slam_init.regular_file import open_regular
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

if TYPE_CHECKING:
    import cv2

__all__ = ["VideoSource", "open_video"]

# Frame rate where the header states none, or one that is impossible.
_NOMINAL_RATE_HZ = 30.0

# A file whose first bytes have no control character but white space is a text.
_TEXT_BYTES = 4096
_NOT_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


@dataclass(frozen=True, eq=False)
class VideoSource:
    """A :class:`slam_init.types.frame.Source` over a video file. The time stamp of a frame is its index over the rate.

    Attributes
    ----------
    path : Path
    length : int
        Number of frames as the header states, or as counted where the header states none or one that is impossible.
    rate_hz : float
        Frames per second.
    size : (int, int)
        Width and height in pixels.
    notes : tuple of str
        Whether the frame rate is assumed, for the user.
    """

    path: Path
    length: int
    rate_hz: float
    size: tuple[int, int]
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """File name."""
        return self.path.name

    @property
    def kind(self) -> str:
        """``video``."""
        return "video"

    @property
    def camera(self) -> Camera | None:
        """None: a video holds no calibration."""
        return None

    @property
    def groundtruth(self) -> Trajectory | None:
        """None: a video holds no ground truth."""
        return None

    @property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps in seconds, index over frame rate."""
        return np.arange(self.length) / self.rate_hz

    def __len__(self) -> int:
        return self.length

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Decode frames in order, always from the beginning of the video, since seeking is inexact.

        A stream may end earlier than its header states. This is an error only if it ends before frame ``start``.

        Parameters
        ----------
        start : int
            Absolute index of the first frame.
        max_frames : int, optional
            Largest number of frames; by default all.

        Yields
        ------
        Frame

        Raises
        ------
        SourceError
            If frame ``start`` cannot be decoded, or if the size of a frame differs from that of the first.
        """
        wanted = frame_range(self.length, start, max_frames, self.name)
        capture = _capture(self.path)
        try:
            for _ in range(wanted.start):
                if not capture.grab():
                    break
            for index in wanted:
                decoded, image = capture.read()
                if not decoded:
                    if index == wanted.start:
                        raise SourceError(f"{self.path}: the video ends before frame {index}")
                    return
                check_size(f"{self.path}, frame {index}", image.shape[1::-1], self.size, "the first frame")
                yield Frame(index, index / self.rate_hz, f"frame-{index:06d}", _as_bytes(image))
        finally:
            capture.release()


def open_video(path: str | os.PathLike[str]) -> VideoSource:
    """Open a video file and decode its first frame.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    VideoSource

    Raises
    ------
    SourceError
        If this is no regular file, a text (a playlist could name other files), a video that OpenCV cannot read or
        without a frame, or if its images have more than :data:`~slam_init.datasets.image_files.MAX_PIXELS` pixels.
    """
    import cv2

    path = Path(path)
    capture = _capture(path)
    try:
        width, height = (capture.get(what) for what in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MAX_PIXELS:
            raise SourceError(
                f"{path}: the header states {width:.0f}x{height:.0f} pixels, more than {MAX_PIXELS / 1e6:.0f} million: "
                "shrink the video"
            )
        decoded, image = capture.read()
        if not decoded:
            raise SourceError(f"{path}: not a readable video, or a video without frames")
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        length = _length(path, capture)
    finally:
        capture.release()
    size = image.shape[1::-1]
    if np.isfinite(rate_hz) and 0 < rate_hz <= 1000:
        return VideoSource(path, length, rate_hz, size)
    note = f"the video states no possible frame rate: {_NOMINAL_RATE_HZ:g} frames a second are assumed"
    return VideoSource(path, length, _NOMINAL_RATE_HZ, size, (note,))


def _length(path: Path, capture: cv2.VideoCapture) -> int:
    """Number of frames as the header states, or as counted after the first one where no such number is possible.

    A frame takes at least a byte of the file.
    """
    import cv2

    stated = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    if 1 <= stated <= min(path.stat().st_size, MAX_FRAMES):
        return int(stated)
    length = 1
    while length < MAX_FRAMES and capture.grab():
        length += 1
    return length


def _capture(path: Path) -> cv2.VideoCapture:
    import cv2

    try:
        str(path).encode()
    except UnicodeEncodeError:  # OpenCV crashes on such names
        raise SourceError(f"{path}: rename the video: its name is not valid Unicode in this locale") from None
    # OpenCV takes a name with a % for a pattern of image names.
    if "%" in path.name:
        raise SourceError(f"{path}: rename the video: OpenCV cannot open names with a %")
    with open_regular(path, SourceError) as file:
        start = file.read(_TEXT_BYTES)
    # A playlist is a text with the names of other files, or of addresses, which OpenCV would read.
    if start and not _NOT_TEXT.search(start):
        raise SourceError(f"{path}: is a text, not a readable video; give a video file, or a folder of images")
    # FFmpeg alone: the other readers of OpenCV take a name with digits for a pattern of image names.
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    # Calibrations refer to pixels as stored: the orientation that a phone writes into the file is not applied.
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    if not capture.isOpened():
        raise SourceError(f"{path}: not a readable video; give a video file, or a folder of images")
    return capture


def _as_bytes(image: object) -> Image:
    return cast(Image, np.asarray(image, np.uint8))
