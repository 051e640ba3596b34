"""Streams of images: a camera through OpenCV, an address and a pipe through PyAV.

Each function is a generator, which is closed to end the connection. Images of an address or of a pipe are those that a
file with the same content gives.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any, TypeAlias, cast

from slam_init.datasets.image_files import check_pixels
from slam_init.datasets.video import upright_pixels
from slam_init.errors import SourceError
from slam_init.types.arrays import Image

# A stream that sends nothing for this long is lost. Cameras send a picture within a second, key frames of network
# cameras come every 2 to 4 s.
_TIMEOUT_S = 10.0
_OPTIONS = {
    "rtsp_flags": "prefer_tcp",
    "fpsprobesize": "0",  # the rate is not measured, for which images would be held back
}
# A pipe with a playlist could make FFmpeg open files.
_PIPE_FORMATS = "yuv4mpegpipe,mjpeg,jpeg_pipe,matroska,webm,mpegts,mpeg,h264,hevc,nut,avi,flv,mov,mp4"
# MJPEG states no times: FFmpeg counts its images at a nominal rate. Over RTSP it does.
_WITHOUT_TIMES = ("mjpeg", "mpjpeg", "jpeg_pipe")
_PIPE_HELP = "pipe a video into it: ffmpeg -i INPUT -f yuv4mpegpipe -pix_fmt yuv420p - | slam-init run -"


#: An image (H, W), grey or BGR, and the time in seconds that the stream states, from any origin; None for none.
StreamImage: TypeAlias = tuple[Image, float | None]


def read_camera(name: str, number: int) -> Iterator[StreamImage]:
    """Read a camera of this machine."""
    import cv2

    capture = cv2.VideoCapture(number)
    try:
        if not capture.isOpened():
            raise SourceError(f"{name}: cannot be opened: check that it runs, and that its name is right")
        while (read := capture.read())[0]:
            yield cast(Image, read[1]), None
    finally:
        capture.release()
    raise SourceError(f"{name}: no more images")


def read_url(name: str, url: str) -> Iterator[StreamImage]:
    """Read a network stream. What it may refer to (a playlist) is bounded by FFmpeg: no file of this machine."""
    yield from _decoded(name, url, "check that it runs, and that its name is right", timeout=_TIMEOUT_S)
    raise SourceError(f"{name}: no more images")


def read_pipe(name: str, descriptor: int) -> Iterator[StreamImage]:
    """Read a video that comes through a pipe."""
    if os.isatty(descriptor):
        raise SourceError(f"{name}: is a terminal: {_PIPE_HELP}")
    with os.fdopen(descriptor, "rb", buffering=0, closefd=False) as file:
        yield from _decoded(name, file, _PIPE_HELP, format_whitelist=_PIPE_FORMATS)


def _decoded(
    name: str, file: object, remedy: str, timeout: float | None = None, **options: str
) -> Iterator[StreamImage]:
    """Decode a stream.

    * ``remedy``: For the message where it cannot be opened.
    """
    import av
    from av.video.reformatter import VideoReformatter

    reformatter, opened = VideoReformatter(), False
    try:
        with av.open(cast(Any, file), mode="r", timeout=timeout, options={**_OPTIONS, **options}) as container:
            if not container.streams.video:
                raise SourceError(f"{name}: holds no images: {remedy}")
            stream, opened = container.streams.video[0], True
            check_pixels(name, stream.width, stream.height, least=0)
            timed = container.format.name not in _WITHOUT_TIMES
            for packet in container.demux(stream):
                try:
                    frames = packet.decode()
                except av.error.InvalidDataError:  # a stream may begin between two key frames, or lose packets
                    continue
                for frame in frames:
                    yield upright_pixels(frame, reformatter), frame.time if timed else None
    except (av.error.FFmpegError, OSError) as error:
        problem = f"{getattr(error, 'strerror', None) or type(error).__name__}"
        end = "ends" if opened else f"cannot be opened: {remedy}"
        raise SourceError(f"{name}: {end} ({problem})") from None
