"""Connections that deliver images: a camera or a network stream, through OpenCV, and a pipe.

A pipe carries raw video with a header (YUV4MPEG2, the format ``yuv4mpegpipe`` of FFmpeg), or MJPEG. Both are recognized
by their first bytes. A Y4M stream states its rate, so that its images have times. MJPEG is a sequence of JPEG images
and states no times.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from slam_init.datasets.grey_levels import GreyLevels
from slam_init.datasets.image_files import MAX_PIXELS, decode_image
from slam_init.errors import SourceError
from slam_init.types.arrays import Image

if TYPE_CHECKING:
    import cv2


@dataclass(frozen=True, eq=False)
class StreamImage:
    """An image of a stream."""

    #: (H, W) Grey or BGR.
    image: Image
    #: Time in seconds that the stream states, from any origin; None if it states none.
    stream_s: float | None


class Stream(Protocol):
    """A connection that delivers images one after the other."""

    def read(self) -> StreamImage | None:
        """Wait for the next image.

        * Returns: None at the end of the stream, or when the connection is lost.
        """
        ...

    def close(self) -> None:
        """End the connection."""
        ...


# -- cameras and addresses -------------------------------------------------------------------------


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


# -- pipes -----------------------------------------------------------------------------------------


_READ_BYTES = 1 << 16
_HELP = "pipe raw video or MJPEG into it: ffmpeg -i INPUT -f yuv4mpegpipe -pix_fmt yuv420p - | slam-init run -"
_Y4M, _JPEG = b"YUV4MPEG2 ", b"\xff\xd8\xff"
# A header has some dozen characters for each of its ten parameters.
_LONGEST_HEADER = 1024
# Bounds of a rate that is possible, as for video files.
_MAX_RATE_HZ = 1000
# Largest JPEG: one byte a pixel of the largest image.
_MAX_JPEG_BYTES = MAX_PIXELS
#: Width and height of a chroma plane over those of the image, by the colour space of the header.
_CHROMA = {"420": (2, 2), "422": (2, 1), "444": (1, 1), "mono": None}


class PipeBytes:
    """The bytes of a pipe, read as they come.

    * ``descriptor``: An open file descriptor. It is not closed.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._buffer = bytearray()

    def peek(self, count: int) -> bytes:
        """Look at the next bytes without taking them."""
        while len(self._buffer) < count and self._fill():
            pass
        return bytes(self._buffer[:count])

    def read(self, count: int) -> bytes:
        """Take the next bytes."""
        taken = self.peek(count)
        del self._buffer[:count]
        return taken

    def find(self, pattern: bytes, start: int, limit: int) -> int:
        """Find a pattern in the bytes that are not taken.

        * Returns: Position; -1 if the pipe ends before, or the limit is reached.
        """
        while (at := self._buffer.find(pattern, start)) < 0:
            start = max(start, len(self._buffer) - len(pattern) + 1)
            if start >= limit or not self._fill():
                return -1
        return at

    def _fill(self) -> bool:
        data = os.read(self._descriptor, _READ_BYTES)
        self._buffer += data
        return bool(data)


def open_pipe(name: str, descriptor: int) -> Stream:
    """Open a video that comes through a pipe."""
    if os.isatty(descriptor):
        raise SourceError(f"{name}: is a terminal: {_HELP}")
    data = PipeBytes(descriptor)
    try:
        start = data.peek(len(_Y4M))
    except OSError as error:
        raise SourceError(f"{name}: cannot be read ({error.strerror}): {_HELP}") from None
    if start == _Y4M:
        return _Y4MStream(name, data)
    if start.startswith(_JPEG):
        return _JpegStream(name, data)
    raise SourceError(f"{name}: {'is neither Y4M nor MJPEG' if start else 'holds nothing'}: {_HELP}")


class _Y4MStream:
    """Raw video of 8 bits with a header. The luminance is decoded, since no colour is needed to track."""

    def __init__(self, name: str, data: PipeBytes) -> None:
        self._name, self._data, self._count = name, data, 0
        end = data.find(b"\n", 0, _LONGEST_HEADER)
        if end < 0:
            raise SourceError(f"{name}: the Y4M header has no end")
        fields = data.read(end + 1).decode("ascii", "replace").split()[1:]
        values = {field[0]: field[1:] for field in fields if field[0] != "X"}
        try:
            self._width, self._height = int(values["W"]), int(values["H"])
            rate = Fraction(*map(int, values.get("F", "0:0").split(":")))
        except (KeyError, ValueError, TypeError, ZeroDivisionError):
            rate = Fraction(0)
            if not {"W", "H"} <= values.keys() or not (values["W"].isdecimal() and values["H"].isdecimal()):
                raise SourceError(f"{name}: the Y4M header states no width and height") from None
        if not 0 < self._width * self._height <= MAX_PIXELS:
            raise SourceError(
                f"{name}: the Y4M header states {self._width}x{self._height} pixels: "
                f"an image has at least one and at most {MAX_PIXELS / 1e6:.0f} million"
            )
        self._interval_s = float(1 / rate) if 0 < rate <= _MAX_RATE_HZ else None
        self._skipped = self._chroma_bytes(values.get("C", "420"))

    def read(self) -> StreamImage | None:
        """Read the next image; None at the end of the pipe."""
        start = self._data.find(b"\n", 0, _LONGEST_HEADER)
        header = self._data.read(start + 1) if start >= 0 else self._data.peek(5)
        if not header:
            return None
        if not header.startswith(b"FRAME"):
            raise SourceError(f"{self._name}: image {self._count} of the Y4M stream does not start with FRAME")
        size = self._width * self._height
        plane = self._data.read(size)
        if len(plane) < size or len(self._data.read(self._skipped)) < self._skipped:
            return None  # the sender has ended within an image
        image = np.frombuffer(plane, np.uint8).reshape(self._height, self._width)
        stream_s = None if self._interval_s is None else self._count * self._interval_s
        self._count += 1
        return StreamImage(image, stream_s)

    def close(self) -> None:
        """Do nothing: the pipe belongs to the process."""

    def _chroma_bytes(self, space: str) -> int:
        found = re.fullmatch(r"(420|422|444|mono)(jpeg|mpeg2|paldv)?", space)
        if found is None:
            raise SourceError(f"{self._name}: Y4M of the colour space {space[:40]!r}: give -pix_fmt yuv420p to ffmpeg")
        factors = _CHROMA[found[1]]
        if factors is None:
            return 0
        return 2 * -(-self._width // factors[0]) * -(-self._height // factors[1])


class _JpegStream:
    """JPEG images one after the other."""

    def __init__(self, name: str, data: PipeBytes) -> None:
        self._name, self._data, self._count = name, data, 0

    def read(self) -> StreamImage | None:
        """Read the next image; None at the end of the pipe."""
        if not self._data.peek(2):
            return None
        end = self._end()
        if end is None:
            return None  # the sender has ended within an image
        image = GreyLevels().reduced(decode_image(f"{self._name}, image {self._count}", self._data.read(end)))
        self._count += 1
        return StreamImage(image, None)

    def close(self) -> None:
        """Do nothing: the pipe belongs to the process."""

    def _end(self) -> int | None:
        """Length of the next image. Its segments are skipped, since a thumbnail in them is a JPEG of its own."""
        at = 2
        while True:
            marker = self._data.peek(at + 4)[at:]
            if len(marker) < 4:
                return None
            if marker[0] != 0xFF:
                raise SourceError(f"{self._name}: image {self._count} of the MJPEG stream is broken")
            length = int.from_bytes(marker[2:], "big")
            at += 2 + length
            if at > _MAX_JPEG_BYTES:
                raise SourceError(f"{self._name}: image {self._count} of the MJPEG stream has no end")
            if marker[1] == 0xDA:  # start of the scan: from here on the end marker stands for itself
                break
        found = self._data.find(b"\xff\xd9", at, _MAX_JPEG_BYTES)
        return None if found < 0 else found + 2
