"""Images of a camera or of a network stream, through OpenCV."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np

from slam_init.datasets.image_files import MAX_PIXELS
from slam_init.datasets.live.stream import StreamImage
from slam_init.errors import SourceError
from slam_init.types.arrays import Image

if TYPE_CHECKING:
    import cv2

# A stream that sends nothing for this long is lost. Cameras send a picture within a second, key frames of network
# cameras come every 2 to 4 s.
_TIMEOUT_MS = 10_000


class CaptureStream:
    """A stream over an opened capture of OpenCV. The times are those that the container or the protocol states.

    * ``name``: For messages.
    * ``capture``: It is closed with the stream.
    * ``timed``: Whether the capture states times. Drivers of cameras state the time of the system's clock or nothing.
    """

    def __init__(self, name: str, capture: cv2.VideoCapture, *, timed: bool) -> None:
        import cv2

        self._capture, self._timed = capture, timed
        if not capture.isOpened():
            capture.release()
            raise SourceError(f"{name}: cannot be opened: check that it runs, and that its name is right")
        width, height = (capture.get(what) for what in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > MAX_PIXELS:
            capture.release()
            raise SourceError(f"{name}: {width:.0f}x{height:.0f} pixels are more than {MAX_PIXELS / 1e6:.0f} million")

    def read(self) -> StreamImage | None:
        """Wait for the next image."""
        import cv2

        found, image = self._capture.read()
        if not found:
            return None
        stream_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3 if self._timed else None
        return StreamImage(cast(Image, np.asarray(image, np.uint8)), stream_s)

    def close(self) -> None:
        """Release the capture."""
        self._capture.release()


def open_camera(name: str, number: int) -> CaptureStream:
    """Open a camera of this machine."""
    import cv2

    return _stream(name, lambda: cv2.VideoCapture(number), timed=False)


def open_url(name: str, url: str) -> CaptureStream:
    """Open a network stream. What it may refer to (a playlist) is bounded by FFmpeg: no file of this machine."""
    import cv2

    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _TIMEOUT_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _TIMEOUT_MS]
    return _stream(name, lambda: cv2.VideoCapture(url, cv2.CAP_FFMPEG, limits), timed=True)


def _stream(name: str, open_capture: Callable[[], cv2.VideoCapture], *, timed: bool) -> CaptureStream:
    import cv2

    try:
        capture = open_capture()
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # the pixels as they are sent, as those of a file
        # MJPEG over HTTP states no times: those of FFmpeg are counted at a nominal rate. Over RTSP it does.
        code = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True)
        counted = code == b"MJPG" and not name.lower().startswith("rtsp")
        return CaptureStream(name, capture, timed=timed and not counted)
    except cv2.error:
        raise SourceError(f"{name}: cannot be opened: check that it runs, and that its name is right") from None
