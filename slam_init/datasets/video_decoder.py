"""Decodes videos, through PyAV, which has the decoders of FFmpeg.

Frames are turned upright by the rotation that the container states (the display matrix, which phones write). Times are
the presentation times of the container, so that a variable frame rate needs no special case.

The video is opened as a file object and not by its name: so the container cannot make FFmpeg open another file.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slam_init.datasets.image_files import MAX_FRAMES, MAX_PIXELS
from slam_init.errors import SourceError
from slam_init.system.regular_file import open_regular
from slam_init.types.arrays import Image

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_CONVERT = "convert it: ffmpeg -i IN -c:v libx264 OUT.mp4"


@dataclass(frozen=True)
class VideoHeader:
    """What a video states about itself."""

    #: (int, int) Width and height of the upright first frame in pixels.
    size: tuple[int, int]
    #: Mean number of frames per second as stated; 0 where none is stated.
    rate_hz: float
    #: Number of frames as stated, or by the stated duration; it may be impossible.
    frames: float
    #: Clockwise rotation that makes the stored images upright: 0, 90, 180 or 270.
    turned_deg: int


@contextmanager
def _opened(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    import av

    with open_regular(path, SourceError) as file, av.open(file, mode="r", metadata_errors="replace") as container:
        if not container.streams.video:
            raise SourceError(f"{path}: not a readable video: it holds no images")
        best = container.streams.best("video")
        stream = next((one for one in container.streams.video if one is best), container.streams.video[0])
        stream.thread_type = "AUTO"
        yield container, stream


def read_header(path: Path) -> VideoHeader:
    """Read the header of a video, and decode its first frame."""
    import av

    try:
        with _opened(path) as (container, stream):
            if stream.codec_context is None:
                raise SourceError(f"{path}: no installed decoder knows the codec of the video: {_CONVERT}")
            width, height = stream.codec_context.width, stream.codec_context.height
            if width * height > MAX_PIXELS:
                raise SourceError(
                    f"{path}: the header states {width}x{height} pixels, more than {MAX_PIXELS / 1e6:.0f} million: "
                    "shrink the video"
                )
            first = next(container.decode(stream), None)
            if first is None:
                raise SourceError(f"{path}: not a readable video, or a video without frames")
            turned_deg = -_quarters(first) * 90 % 360
            size = (first.width, first.height) if turned_deg % 180 == 0 else (first.height, first.width)
            rate_hz = float(stream.average_rate or stream.guessed_rate or 0)
            seconds = (container.duration or 0) / av.time_base
            return VideoHeader(size, rate_hz, stream.frames or np.floor(seconds * rate_hz + 0.5), turned_deg)
    except (av.error.FFmpegError, ValueError) as error:
        cause = getattr(error, "strerror", None) or error
        raise SourceError(f"{path}: not a readable video ({cause}); give a video file, or a folder of images") from None


def _quarters(frame: VideoFrame) -> int:
    """The quarters of a turn, anticlockwise, that make a frame upright."""
    return round(frame.rotation / 90) % 4


def decoded(path: Path, skip: int = 0) -> Iterator[tuple[float, Image | None]]:
    """Decode a video from its beginning, since seeking is inexact.

    Shapes: returns ``image`` (H, W, 3).

    * ``skip``: Number of frames at the beginning whose images are not needed.
    * Returns ``time_s``: Presentation time in the container in whole nanoseconds, from the start of its stream; NaN
      where it states none.
    * Returns ``image``: The upright frame, BGR; None for a skipped one. A frame that cannot be decoded ends the video.
    """
    import av
    from av.video.reformatter import VideoReformatter

    # One for all frames, since each makes tables. The interpolation is that of OpenCV, for colours of half the size.
    reformatter = VideoReformatter()
    with _opened(path) as (container, stream):
        start_s = _start_s(stream)
        try:
            for index, frame in enumerate(container.decode(stream)):
                time_s = np.nan if frame.time is None else _nanoseconds(frame.time - start_s)
                if index < skip:
                    yield time_s, None
                    continue
                pixels = reformatter.reformat(frame, format="bgr24", interpolation="BICUBIC").to_ndarray()
                yield time_s, np.ascontiguousarray(np.rot90(pixels, _quarters(frame)), np.uint8)
        except av.error.FFmpegError:
            return


def packet_times_s(path: Path) -> list[float]:
    """Read the presentation times of all frames. The file is read, and nothing is decoded.

    * Returns: Ascending; empty where the container states no times. Frames before the start of the stream, which an
      edit list hides, are left out.
    """
    import av

    times_s: list[float] = []
    with _opened(path) as (container, stream):
        start_s, unit_s = _start_s(stream), float(stream.time_base or 0)
        try:
            for packet in container.demux(stream):
                stamp = packet.dts if packet.pts is None else packet.pts  # AVI has no presentation times
                if stamp is not None and packet.size:
                    times_s.append(_nanoseconds(stamp * unit_s - start_s))
                if len(times_s) >= MAX_FRAMES:
                    break
        except av.error.FFmpegError:  # the times up to the damage
            pass
    return sorted(time_s for time_s in times_s if time_s >= 0)


def count_frames(path: Path) -> int:
    """Count the frames of a video by decoding it."""
    frames = decoded(path, skip=MAX_FRAMES)
    return sum(1 for _, _ in zip(range(MAX_FRAMES), frames, strict=False))


def is_gif(path: Path) -> bool:
    """Whether a file is a GIF."""
    with open_regular(path, SourceError) as file:
        return file.read(6) in (b"GIF87a", b"GIF89a")


def _start_s(stream: VideoStream) -> float:
    return float((stream.start_time or 0) * (stream.time_base or 0))


def _nanoseconds(time_s: float) -> float:
    """Seconds without the rounding of the decoder: 0.3 and not 0.30000000000000004."""
    return round(time_s, 9)
