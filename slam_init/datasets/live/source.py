"""A source of frames that come in their own time. A thread receives them, and a short queue holds the newest ones.

An image that finds the queue full replaces the oldest one, which is dropped and counted: an initializer that is slower
than a camera sees fewer frames, and never old ones. The writer of a pipe waits instead, and so does any sender that is
to lose no frame.

The times are those that the stream states, from the moment of its first image on. Where an image states no later time
than the one before, they are the times of arrival from there on. Both are seconds since 1970. Frames are numbered as
they arrive, so that dropped frames leave gaps. The source ends where its stream does.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from slam_init.datasets.image_files import NOMINAL_RATE_HZ
from slam_init.datasets.live.streams import StreamImage
from slam_init.errors import SourceError
from slam_init.types.arrays import Image
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

#: Frames that wait: those of a quarter of a second at 30 Hz. Judging a frame takes up to six tenths of a second
#: (docs/measurements/speed.md); what comes beyond the queue is dropped.
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
        self._clock = _Clock(keep_all)
        self._read: Frame | None = None
        self._size = (0, 0)
        self._begun = self._stopped = self._ended = False
        self._received = 0
        self._error: BaseException | None = None
        self._end_note: str | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know: dropped frames, times that are not those of the stream, and how it ended."""
        dropped = f"{self.dropped} of {self._received} frames were dropped: they came faster than they were processed"
        ended = () if self._end_note is None else (self._end_note,)
        return (*(dropped,) * bool(self.dropped), *self._clock.notes, *ended)

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
        self._stopped, self._end_note = True, "the source was stopped by the user"

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
        while not self._stopped:
            ended = self._ended  # before the queue is looked at: what was received before the end is processed
            with suppress(queue.Empty):
                self._read = self._queue.get(timeout=0 if ended else _POLL_S)
                return self._read
            if ended and self._error is not None:
                raise self._error
            if ended:
                return None
        return None

    # -- the side of the thread -------------------------------------------------------------------

    def _receive(self) -> None:
        try:
            for image, stream_s in self._connect():
                if self._stopped:
                    break
                self._put(image, stream_s)
        except SourceError as error:
            if self._received:  # what was received is of use without the rest
                self._end_note = f"the source ended: {error}"
            else:
                self._error = error
        except BaseException as error:
            self._error = error
        self._ended = True

    def _put(self, image: Image, stream_s: float | None) -> None:
        """Add an image to the queue; the oldest one makes room, or the sender waits."""
        index, (height, width) = self._received, image.shape[:2]
        size = width, height
        self._size = size if index == 0 else self._size
        if size != self._size:
            raise SourceError(f"{self.name}: image {index} is {width}x{height}: all sizes must be equal")
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
    """

    def __init__(self, nominal: bool) -> None:
        self._nominal, self._stated = nominal, True
        self._offset_s = self._stream_s = self._last_s = -1.0
        self.notes: list[str] = []

    def time_of(self, stream_s: float | None) -> float:
        """Time stamp of an image that has just arrived: seconds since 1970, after the one before."""
        now_s = time.time()
        if stream_s is None and self._nominal:
            stream_s = self._stream_s + 1 / NOMINAL_RATE_HZ
            self._note(f"the stream states no times: {NOMINAL_RATE_HZ:g} frames a second are assumed")
        if self._last_s < 0:
            self._offset_s = now_s - (stream_s or 0.0)
        elif self._stated and stream_s is not None and stream_s <= self._stream_s:
            self._stated = False
            self._note("the times of the stream do not increase: times of arrival are taken")
        self._stated &= stream_s is not None
        time_s = self._offset_s + stream_s if self._stated and stream_s is not None else now_s
        self._stream_s = self._stream_s if stream_s is None else stream_s
        self._last_s = max(time_s, self._last_s + _LEAST_STEP_S)
        return self._last_s

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)
