"""Live sources: a camera of this machine, a network stream, and a video on the standard input.

A source of frames that come in their own time: a thread receives them, and a short queue holds the newest ones.

An image that finds the queue full replaces the oldest one, which is dropped and counted: an initializer that is slower
than a camera sees fewer frames, and never old ones. The writer of a pipe waits instead, and so does any sender that is
to lose no frame.

A camera is read through OpenCV, an address and a pipe through PyAV. Images of an address or of a pipe are those that a
file with the same content gives.

The times are those that the stream states, from the moment of its first image on. Where an image states no later time
than the one before, they are the times of arrival from there on. Both are seconds since 1970. Frames are numbered as
they arrive, so that dropped frames leave gaps. The source ends where its stream does.
"""

from __future__ import annotations

import os
import queue
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias, cast

from slam_init.datasets.image_files import NOMINAL_RATE_HZ, check_pixels
from slam_init.datasets.video import upright_pixels
from slam_init.errors import SourceError
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

# A stream that sends nothing for this long is lost. Cameras send a picture within a second, key frames of network
# cameras come every 2 to 4 s.
_TIMEOUT_S = 10.0
# The rate is not measured, for which images would be held back.
_OPTIONS = {"rtsp_flags": "prefer_tcp", "fpsprobesize": "0"}
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


# -- the source ------------------------------------------------------------------------------------


#: Frames that wait: those of a quarter of a second at 30 Hz. The evaluation of a frame takes up to six tenths of a
#: second (docs/measurements/speed.md); what comes beyond the queue is dropped.
QUEUE_FRAMES = 8
# How often a waiting thread looks whether it was stopped.
_POLL_S = 0.05
# Smallest step between two time stamps: a double keeps the seconds since 1970 to a quarter of a microsecond.
_LEAST_STEP_S = 1e-6


class LiveSource:
    """A :class:`slam_init.types.frame.Source` without an end and without a length. It is also a context manager.

    The frames can be read once. A frame that was read stays the first one of the next call of :meth:`frames`, so that
    a caller may look at its size.

    * ``name``: Name of the camera or the address, without a password.
    * ``dropped``: Number of frames that were dropped since the first one was processed.
    * ``connect``: Gives the images of the stream as they come. It raises
      :class:`~slam_init.errors.SourceError` where it cannot be opened, or is lost.
    * ``keep_all``: Whether the sender waits for a free place in the queue instead of a frame being dropped.
    """

    def __init__(self, name: str, connect: Callable[[], Iterator[StreamImage]], *, keep_all: bool = False) -> None:
        self.name, self.kind = name, "live"
        # A stream holds neither.
        self.camera: Camera | None = None
        self.groundtruth: Trajectory | None = None
        self.dropped = 0
        self._connect, self._keep_all = connect, keep_all
        self._thread: threading.Thread | None = None
        self._queue: queue.Queue[Frame] = queue.Queue(QUEUE_FRAMES)
        # What the user should know, each note once.
        self._said: dict[str, None] = {}
        self._clock = _Clock(keep_all, self._said)
        self._read: Frame | None = None
        self._size: tuple[int, ...] = ()
        self._begun = self._stopped = self._ended = False
        self._received = 0
        self._error: BaseException | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know: dropped frames, times that are not those of the stream, and how it ended."""
        if not self.dropped:
            return tuple(self._said)
        dropped = f"{self.dropped} of {self._received} frames were dropped"
        return (f"{dropped}: they came faster than they were processed", *self._said)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Give the frames as they come, until the stream ends or :meth:`stop` is called."""
        given = 0
        self._begun |= self._read is not None
        frame = self._read
        while frame is not None or (frame := self._next()) is not None:
            if frame.index >= start:
                given += 1
                yield frame
                if given == max_frames:
                    return
            frame, self._begun = None, True
        if not given and not self._stopped:
            raise SourceError(f"{self.name}: ends before frame {start}")

    def stop(self) -> None:
        """End the source as if its data had ended. It may be called from a signal handler."""
        self._stopped = True
        self._said["the source was stopped by the user"] = None

    def __enter__(self) -> LiveSource:
        return self

    def __exit__(self, *_: object) -> None:
        """End the connection. A thread that waits for a camera or a pipe ends with the process."""
        self._stopped = True
        if self._thread is not None:
            self._thread.join(2 * _POLL_S)

    def _next(self) -> Frame | None:
        """Wait for the next frame; None at the end."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._receive, name="live source", daemon=True)
            self._thread.start()
        ended = False
        while not (ended or self._stopped):
            ended = self._ended  # before the queue is looked at: what was received before the end is processed
            with suppress(queue.Empty):
                self._read = self._queue.get(timeout=0 if ended else _POLL_S)
                return self._read
        if self._error is not None and not self._stopped:
            raise self._error
        return None

    # -- the side of the thread -------------------------------------------------------------------

    def _receive(self) -> None:
        try:
            for image, stream_s in self._connect():
                if self._stopped:
                    break
                self._put(image, stream_s)
        except BaseException as error:
            if isinstance(error, SourceError) and self._received:  # what was received is of use without the rest
                self._said[f"the source ended: {error}"] = None
            else:
                self._error = error
        self._ended = True

    def _put(self, image: Image, stream_s: float | None) -> None:
        """Add an image to the queue; the oldest one makes room, or the sender waits."""
        index, size = self._received, image.shape[1::-1]
        self._size = self._size or size
        if size != self._size:
            raise SourceError(f"{self.name}: image {index} is {size[0]}x{size[1]}: all sizes must be equal")
        frame = Frame(index, self._clock.time_of(stream_s), f"frame-{index:06d}", image)
        self._received += 1
        while not self._stopped:
            with suppress(queue.Full):
                self._queue.put(frame, timeout=_POLL_S if self._keep_all else 0)
                return
            if not self._keep_all:
                with suppress(queue.Empty):
                    self._queue.get_nowait()
                    self.dropped += self._begun
                    # A frame that was looked at is too old where others were dropped since.
                    self._read = self._read if self._begun else None


class _Clock:
    """Makes time stamps of stated times and of times of arrival.

    * ``nominal``: Whether images without a stated time get one by a nominal rate: where the sender waits, the times of
      arrival are those of the processing.
    * ``notes``: Its keys get what the user should know.
    """

    def __init__(self, nominal: bool, notes: dict[str, None]) -> None:
        self._nominal, self._stated, self._notes = nominal, True, notes
        self._offset_s = self._stream_s = self._last_s = -1.0

    def time_of(self, stream_s: float | None) -> float:
        """Time stamp of an image that has just arrived: seconds since 1970, after the one before."""
        now_s = time.time()
        if stream_s is None and self._nominal:
            stream_s = self._stream_s + 1 / NOMINAL_RATE_HZ
            self._notes[f"the stream states no times: {NOMINAL_RATE_HZ:g} frames a second are assumed"] = None
        if self._last_s < 0:
            self._offset_s = now_s - (stream_s or 0.0)
        elif self._stated and stream_s is not None and stream_s <= self._stream_s:
            self._stated = False
            self._notes["the times of the stream do not increase: times of arrival are taken"] = None
        self._stated &= stream_s is not None
        time_s = self._offset_s + stream_s if self._stated and stream_s is not None else now_s
        self._stream_s = self._stream_s if stream_s is None else stream_s
        self._last_s = max(time_s, self._last_s + _LEAST_STEP_S)
        return self._last_s


# -- names -----------------------------------------------------------------------------------------


_PIPE = "-"
_CAMERA = "camera:"
_URL = re.compile(r"(rtsps?|https?)://[^/\s]", re.IGNORECASE)
_PASSWORD = re.compile(r"(?<=://)[^/@\s]*@")


def is_live(text: str) -> bool:
    """Tell whether a name is that of a live source.

    * Returns: True for ``camera:N``, ``rtsp://...``, ``http://...``, ``https://...`` and ``-``.
    """
    return text == _PIPE or text.startswith(_CAMERA) or _URL.match(text) is not None


def open_live(text: str, *, keep_all: bool = False) -> LiveSource:
    """Open a live source. Nothing is connected before its frames are asked for.

    * ``text``: ``camera:N``, ``rtsp://...``, ``http://...``, ``https://...``, or ``-`` for the standard input, whose
      writer always waits.
    """
    if text == _PIPE:
        return LiveSource("standard input", partial(read_pipe, "standard input", 0), keep_all=True)
    if text.startswith(_CAMERA):
        number = text.removeprefix(_CAMERA)
        if not (number.isascii() and number.isdecimal() and len(number) < 4):
            raise SourceError(f"{text!r}: give the number of a camera, as in camera:0")
        return LiveSource(text, partial(read_camera, text, int(number)), keep_all=keep_all)
    if _URL.match(text) is None:
        raise SourceError(f"{text!r}: is no live source: give camera:0, an rtsp or http address, or -")
    name = without_password(text)
    return LiveSource(name, partial(read_url, name, text), keep_all=keep_all)


def without_password(text: str) -> str:
    """Remove user and password from the addresses in a text."""
    return _PASSWORD.sub("", text)
