"""The decoders of videos: OpenCV, and PyAV for codecs that OpenCV was built without.

OpenCV is asked first, so that a video gives the same frames whether PyAV is installed or not. Its wheels decode H.264,
HEVC, VP9 and ProRes, of 8 and of 10 bits, and no AV1. Of a frame that is marked as interlaced OpenCV gives the image
that was in its memory before, without an error: its converter of colours refuses such frames. PyAV converts them.

Frames are turned upright by the rotation that the container states (the display matrix, which phones write). Times are
the presentation times of the container, so that a variable frame rate needs no special case.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, cast

import numpy as np

from slam_init.datasets.image_files import MAX_FRAMES, MAX_PIXELS
from slam_init.errors import SourceError
from slam_init.system.regular_file import open_regular
from slam_init.types.arrays import Image

if TYPE_CHECKING:
    import cv2
    from av.container import InputContainer
    from av.video.stream import VideoStream

#: Name of a decoder.
Decoder: TypeAlias = Literal["opencv", "pyav"]

#: How to get the decoder that OpenCV lacks.
_CONVERT = "convert it: ffmpeg -i IN -c:v libx264 OUT.mp4"
_INSTALL = f'pip install "slam-init[video]", or {_CONVERT}'


@dataclass(frozen=True)
class VideoHeader:
    """What a video states about itself."""

    #: ``opencv`` or ``pyav``: the decoder that can decode the first frame.
    decoder: Decoder
    #: (int, int) Width and height of the upright first frame in pixels.
    size: tuple[int, int]
    #: Mean number of frames per second as stated; 0 or NaN where none is stated.
    rate_hz: float
    #: Number of frames as stated; it may be impossible.
    frames: float
    #: Clockwise rotation that makes the stored images upright: 0, 90, 180 or 270.
    turned_deg: int


def read_header(path: Path) -> VideoHeader:
    """Read the header of a video, and decode its first frame."""
    import cv2

    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        if not capture.isOpened():
            return _pyav_header(path, codec="")
        width, height = (capture.get(what) for what in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        _check_pixels(path, width, height)
        found, image = capture.read()
        if not found:
            return _pyav_header(path, codec=_four_letters(capture))
        found, second = capture.read()
        # OpenCV cannot convert interlaced frames, and repeats what is in its memory.
        if found and np.array_equal(image, second) and _starts_interlaced(path):
            return _pyav_header(path, codec=_four_letters(capture))
        turned_deg = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360
        rate_hz, frames = (capture.get(what) for what in (cv2.CAP_PROP_FPS, cv2.CAP_PROP_FRAME_COUNT))
        return VideoHeader("opencv", image.shape[1::-1], rate_hz, frames, turned_deg)
    finally:
        capture.release()


def decoded(path: Path, decoder: Decoder, skip: int = 0) -> Iterator[tuple[float, Image | None]]:
    """Decode a video from its beginning, since seeking is inexact.

    Shapes: returns ``image`` (H, W, 3).

    * ``skip``: Number of frames at the beginning whose images are not needed.
    * Returns ``time_s``: Presentation time in the container in whole nanoseconds, from the start of its stream; NaN
      where it states none.
    * Returns ``image``: The upright frame, BGR; None for a skipped one. A frame that cannot be decoded ends the video.
    """
    yield from _decoded_by_opencv(path, skip) if decoder == "opencv" else _decoded_by_pyav(path, skip)


def packet_times_s(path: Path, decoder: Decoder) -> list[float]:
    """Read the presentation times of all frames. The file is read, and nothing is decoded.

    * Returns: Ascending; empty where the container states no times. Frames before the start of the stream, which an
      edit list hides, are left out.
    """
    found = _opencv_packet_times(path) if decoder == "opencv" else _pyav_packet_times(path)
    return sorted(time_s for time_s in found if np.isfinite(time_s) and time_s >= 0)


def count_frames(path: Path, decoder: Decoder) -> int:
    """Count the frames of a video by decoding it."""
    frames = decoded(path, decoder, skip=MAX_FRAMES)
    return sum(1 for _, _ in zip(range(MAX_FRAMES), frames, strict=False))


def _check_pixels(path: Path, width: float, height: float) -> None:
    if width * height > MAX_PIXELS:
        raise SourceError(
            f"{path}: the header states {width:.0f}x{height:.0f} pixels, more than {MAX_PIXELS / 1e6:.0f} million: "
            "shrink the video"
        )


def _nanoseconds(time_s: float) -> float:
    """Seconds without the rounding of the decoder: 0.3 and not 0.30000000000000004."""
    return round(time_s, 9)


# -- OpenCV ----------------------------------------------------------------------------------------


def _four_letters(capture: cv2.VideoCapture) -> str:
    """The name of the codec, as ``av01``; empty where none is stated."""
    import cv2

    code = int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    name = code.to_bytes(4, "little").decode("ascii", "replace").strip().lower()
    return name if name.isalnum() else ""


def _decoded_by_opencv(path: Path, skip: int) -> Iterator[tuple[float, Image | None]]:
    import cv2

    # FFmpeg alone: the other readers of OpenCV take a name with digits for a pattern of image names.
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
    try:
        index = 0
        while capture.grab():
            time_s = _nanoseconds(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
            if index < skip:
                yield time_s, None
            else:
                found, image = capture.retrieve()
                if not found:
                    return
                yield time_s, cast(Image, np.asarray(image, np.uint8))
            index += 1
    finally:
        capture.release()


def _opencv_packet_times(path: Path) -> list[float]:
    import cv2

    # The format -1 asks for packets as they are stored, which are not decoded.
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    times_s: list[float] = []
    try:
        while len(times_s) < MAX_FRAMES and capture.grab():
            times_s.append(_nanoseconds(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000))
    finally:
        capture.release()
    return times_s


# -- PyAV ------------------------------------------------------------------------------------------


@contextmanager
def _pyav_opened(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    import av

    # A file object instead of a name: the container cannot make FFmpeg open another file.
    with open_regular(path, SourceError) as file, av.open(file, mode="r") as container:
        if not container.streams.video:
            raise SourceError(f"{path}: not a readable video: it holds no images")
        best = container.streams.best("video")
        yield container, next((one for one in container.streams.video if one is best), container.streams.video[0])


def _pyav_header(path: Path, codec: str) -> VideoHeader:
    """The header by PyAV, for a video that OpenCV cannot decode."""
    try:
        import av
    except ImportError:
        cause = "not a readable video, or a video without frames; give a video file, or a folder of images"
        if codec:
            cause = f"this OpenCV cannot decode the codec {codec} of the video: {_INSTALL}"
        raise SourceError(f"{path}: {cause}") from None
    try:
        with _pyav_opened(path) as (container, stream):
            if stream.codec_context is None:
                raise SourceError(f"{path}: no installed decoder knows the codec of the video: {_CONVERT}")
            _check_pixels(path, stream.codec_context.width, stream.codec_context.height)
            first = next(container.decode(stream), None)
            if first is None:
                raise SourceError(f"{path}: not a readable video, or a video without frames")
            turned_deg = -round(first.rotation / 90) * 90 % 360
            size = (first.width, first.height) if turned_deg % 180 == 0 else (first.height, first.width)
            return VideoHeader("pyav", size, float(stream.average_rate or 0), float(stream.frames), turned_deg)
    except (av.error.FFmpegError, ValueError) as error:
        cause = f" (codec {codec})" if codec else ""
        raise SourceError(f"{path}: not a readable video{cause}: {getattr(error, 'strerror', None) or error}") from None


def is_gif(path: Path) -> bool:
    """Whether a file is a GIF."""
    with open_regular(path, SourceError) as file:
        return file.read(6) in (b"GIF87a", b"GIF89a")


def _starts_interlaced(path: Path) -> bool:
    """Whether the first frame is marked as interlaced; False without PyAV."""
    try:
        import av
    except ImportError:
        return False
    try:
        with _pyav_opened(path) as (container, stream):
            first = next(container.decode(stream), None)
            return first is not None and first.interlaced_frame
    except (av.error.FFmpegError, ValueError, AttributeError):  # AttributeError: a stream without a decoder
        return False


def _decoded_by_pyav(path: Path, skip: int) -> Iterator[tuple[float, Image | None]]:
    import av

    with _pyav_opened(path) as (container, stream):
        start_s = _start_s(stream)
        try:
            for index, frame in enumerate(container.decode(stream)):
                time_s = float("nan") if frame.time is None else _nanoseconds(frame.time - start_s)
                if index < skip:
                    yield time_s, None
                    continue
                image = np.rot90(frame.to_ndarray(format="bgr24"), round(frame.rotation / 90) % 4)
                yield time_s, np.ascontiguousarray(image, np.uint8)
        except av.error.FFmpegError:  # a damaged frame ends the video, as in OpenCV
            return


def _pyav_packet_times(path: Path) -> list[float]:
    import av

    times_s: list[float] = []
    with _pyav_opened(path) as (container, stream):
        start_s, unit_s = _start_s(stream), float(stream.time_base or 0)
        try:
            for packet in container.demux(stream):
                if packet.pts is not None:
                    times_s.append(_nanoseconds(packet.pts * unit_s - start_s))
                if len(times_s) >= MAX_FRAMES:
                    break
        except av.error.FFmpegError:  # the times up to the damage
            pass
    return times_s


def _start_s(stream: VideoStream) -> float:
    return float((stream.start_time or 0) * (stream.time_base or 0))
