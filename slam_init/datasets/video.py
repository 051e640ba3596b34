"""Video files, through OpenCV."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from slam_init.datasets.image_files import check_size, frame_range
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats, Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

if TYPE_CHECKING:
    import cv2

__all__ = ["VideoSource", "open_video"]

# Frame rate where the header states none, or one that is impossible.
_NOMINAL_RATE_HZ = 30.0


@dataclass(frozen=True, eq=False)
class VideoSource:
    """A :class:`slam_init.types.frame.Source` over a video file. The time stamp of a frame is its index over the rate.

    Attributes
    ----------
    path : Path
    length : int
        Number of frames as the header states, or as counted where the header states none.
    rate_hz : float
        Frames per second.
    size : (int, int)
        Width and height in pixels.
    """

    path: Path
    length: int
    rate_hz: float
    size: tuple[int, int]

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
                capture.grab()
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
        If OpenCV cannot read the file, or if the video has no frame.
    """
    import cv2

    path = Path(path)
    capture = _capture(path)
    try:
        decoded, image = capture.read()
        if not decoded:
            raise SourceError(f"{path}: not a readable video, or a video without frames")
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        length = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if length < 1:
            length = 1
            while capture.grab():
                length += 1
    finally:
        capture.release()
    possible = np.isfinite(rate_hz) and 0 < rate_hz <= 1000
    return VideoSource(path, length, rate_hz if possible else _NOMINAL_RATE_HZ, image.shape[1::-1])


def _capture(path: Path) -> cv2.VideoCapture:
    import cv2

    try:
        str(path).encode()
    except UnicodeEncodeError:  # OpenCV crashes on such names
        raise SourceError(f"{path}: rename the video: its name is not valid Unicode in this locale") from None
    # OpenCV takes a name with a % for a pattern of image names.
    if "%" in path.name:
        raise SourceError(f"{path}: rename the video: OpenCV cannot open names with a %")
    capture = cv2.VideoCapture(str(path))
    # Calibrations refer to pixels as stored: the orientation that a phone writes into the file is not applied.
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    if not capture.isOpened():
        raise SourceError(f"{path}: not a readable video; give a video file, or a folder of images")
    return capture


def _as_bytes(image: object) -> Image:
    return cast(Image, np.asarray(image, np.uint8))
