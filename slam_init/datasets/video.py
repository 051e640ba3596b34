"""Video files.

A frame comes upright and at the time that the container states (:mod:`slam_init.datasets.video_decoder`); an
interlaced video gives one field of each frame (:mod:`slam_init.datasets.interlaced`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from slam_init.datasets.image_files import MAX_FRAMES, check_size, frame_range
from slam_init.datasets.interlaced import NOTE, Deinterlacer
from slam_init.datasets.video_decoder import count_frames, decoded, is_gif, packet_times_s, read_header
from slam_init.errors import SourceError
from slam_init.system.regular_file import open_regular
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

# Frame rate where the header states none, or one that is impossible.
_NOMINAL_RATE_HZ = 30.0

# A file whose first bytes have no control character but white space is a text.
_TEXT_BYTES = 4096
_NOT_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


@dataclass(frozen=True, eq=False)
class VideoSource:
    """A :class:`slam_init.types.frame.Source` over a video file. The time stamp of a frame is that of the container."""

    path: Path
    #: Number of frames as the header states, or as counted where the header states none or one that is impossible.
    length: int
    #: Mean number of frames per second. A frame without a possible time in the container comes one interval after the
    #: frame before it.
    rate_hz: float
    #: (int, int) Width and height of the upright frames in pixels.
    size: tuple[int, int]
    #: What the header tells the user: whether the frame rate is assumed, or the frames are turned.
    header_notes: tuple[str, ...] = ()
    kind: str = "video"
    #: camera, groundtruth: A video holds neither.
    camera: Camera | None = None
    groundtruth: Trajectory | None = None
    _seen: set[str] = field(default_factory=set, init=False, repr=False)

    @property
    def name(self) -> str:
        """File name."""
        return self.path.name

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know about the video, from its header and from the frames that were read."""
        return (*self.header_notes, *sorted(self._seen))

    @cached_property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps in seconds. The file is read for them, and nothing is decoded."""
        times_s = list(_increasing(packet_times_s(self.path)[: self.length], 1 / self.rate_hz))
        # A container may hold fewer times than frames, or none.
        nominal = (times_s[-1] if times_s else -1 / self.rate_hz) + np.arange(1, self.length + 1) / self.rate_hz
        return np.array([*times_s, *nominal[: self.length - len(times_s)]])

    def __len__(self) -> int:
        return self.length

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Decode frames in order, always from the beginning of the video, since seeking is inexact.

        A stream may end earlier than its header states. This is an error only if it ends before frame ``start``.
        """
        wanted = frame_range(self.length, start, max_frames, self.name)
        # A GIF has no fields; its few colours are dithered, which looks like a comb.
        deinterlacer = None if is_gif(self.path) else Deinterlacer()
        stream = decoded(self.path, skip=wanted.start)
        last_s: float | None = None
        for index in range(wanted.stop):
            time_s, image = next(stream, (0.0, None))
            if image is None and index >= wanted.start:
                if index == wanted.start:
                    raise SourceError(f"{self.path}: the video ends before frame {index}")
                return
            last_s = _next_time(time_s, last_s, 1 / self.rate_hz)
            if image is None:
                continue
            check_size(f"{self.path}, frame {index}", image.shape[1::-1], self.size, "the first frame")
            if deinterlacer is not None:
                image = deinterlacer.process(image)
                if deinterlacer.found:
                    self._seen.add(NOTE)
            yield Frame(index, last_s, f"frame-{index:06d}", image)


def open_video(path: str | os.PathLike[str]) -> VideoSource:
    """Open a video file and decode its first frame."""
    path = Path(path)
    _check_file(path)
    header = read_header(path)
    notes: list[str] = []
    if header.turned_deg:
        notes.append(
            f"the frames are turned by {header.turned_deg} degrees, as the video states: a calibration has to be that "
            "of upright images"
        )
    rate_hz = header.rate_hz
    if not (np.isfinite(rate_hz) and 0 < rate_hz <= 1000):
        rate_hz = _NOMINAL_RATE_HZ
        notes.append(f"the video states no possible frame rate: {rate_hz:g} frames a second are assumed")
    # A frame takes at least a byte of the file.
    if 1 <= header.frames <= min(path.stat().st_size, MAX_FRAMES):
        length = int(header.frames)
    else:
        length = max(count_frames(path), 1)
    return VideoSource(path, length, rate_hz, header.size, tuple(notes))


def _next_time(time_s: float, last_s: float | None, interval_s: float) -> float:
    """The time of a frame: later than that of the frame before, also where the container states none or an earlier."""
    if last_s is None:
        return time_s if np.isfinite(time_s) and time_s >= 0 else 0.0
    return time_s if time_s > last_s else last_s + interval_s


def _increasing(times_s: Iterable[float], interval_s: float) -> Iterator[float]:
    last_s: float | None = None
    for time_s in times_s:
        last_s = _next_time(time_s, last_s, interval_s)
        yield last_s


def _check_file(path: Path) -> None:
    """Refuse a file that is not to be given to a decoder."""
    with open_regular(path, SourceError) as file:
        start = file.read(_TEXT_BYTES)
    # A playlist is a text with the names of other files, or of addresses, which FFmpeg would read.
    if start and not _NOT_TEXT.search(start):
        raise SourceError(f"{path}: is a text, not a readable video; give a video file, or a folder of images")
