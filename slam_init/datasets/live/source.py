"""A source of frames that come in their own time. A thread receives them, and a short queue holds the newest ones.

An image that finds the queue full replaces the oldest one, which is dropped and counted: an initializer that is slower
than a camera sees fewer frames, and never old ones. A sender that runs ahead of the times it states is no camera but a
file at full speed: it has to wait. A pipe waits anyway until the second frame is asked for, which is when the
processing begins, and a pipe whose writer is ahead once is a file, of which no frame is dropped. A network stream is
not, since servers send the last seconds at once when a client comes.

The times are those that the stream states, from the moment of its first image on; where it states none, or times that
do not increase, they are the times of arrival. Both are seconds since 1970. Frames are numbered as they arrive, so that
dropped frames leave gaps.

A lost connection is tried again a limited number of times, with growing pauses. Then the source ends like a file.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

from slam_init.datasets.image_files import NOMINAL_RATE_HZ
from slam_init.datasets.live.streams import Stream, StreamImage
from slam_init.errors import SourceError
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

#: Frames that wait: those of a quarter of a second at 30 Hz. Judging a frame takes up to six tenths of a second
#: (docs/speed.md); what comes beyond the queue is dropped.
QUEUE_FRAMES = 8
# First pause before a lost connection is tried again; each further one is twice as long.
_FIRST_PAUSE_S = 0.5
# How often a waiting thread looks whether it was stopped.
_POLL_S = 0.05
# A stream is ahead of its times by more than this. Networks delay images by some 10 ms, and the first one by any time.
_JITTER_S = 0.1
# So many images in a row without a later time are left out. RTSP knows the time after the first one.
_MAX_REPEATED = 3
# Smallest step between two time stamps: a double keeps the seconds since 1970 to a quarter of a microsecond.
_LEAST_STEP_S = 1e-6


class LiveSource:
    """A :class:`slam_init.types.frame.Source` without an end and without a length. It is also a context manager.

    The frames can be read once. A frame that was read stays the first one of the next call of :meth:`frames`, so that
    a caller may look at its size.

    * ``name``: Name of the camera or the address, without a password.
    * ``dropped``: Number of frames that were dropped since the first one was processed.
    * ``connect``: Opens the stream; called again when the connection is lost. It raises
      :class:`~slam_init.errors.SourceError` where it cannot.
    * ``pipe``: Whether the sender waits until its images are taken, as the writer of a pipe does.
    * ``keep_all``: Whether the sender waits for a free place in the queue instead of a frame being dropped.
    * ``reconnects``: How many times in a row a lost connection is tried again.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[], Stream],
        *,
        pipe: bool = False,
        keep_all: bool = False,
        reconnects: int = 3,
    ) -> None:
        self.name, self.kind = name, "live"
        # A stream holds neither.
        self.camera: Camera | None = None
        self.groundtruth: Trajectory | None = None
        self._connect, self._pipe, self._keep_all, self._reconnects = connect, pipe, keep_all, reconnects
        self._thread: threading.Thread | None = None
        self._changed = threading.Condition()
        self._queue: deque[Frame] = deque()
        self._clock = _Clock(keep_all)
        self._read: Frame | None = None
        self._begun = self._stale = False
        self._stopped = self._ended = self._interrupted = False
        self._received = self.dropped = self._connections = 0
        self._error: BaseException | None = None
        self._ended_by: str | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know.

        * Returns: Dropped frames, times that are not those of the stream, connections that were lost, and how the
          source ended.
        """
        notes = []
        if self.dropped:
            notes.append(
                f"{self.dropped} of {self._received} frames were dropped, because they came faster than they were "
                "processed"
            )
        notes += self._clock.notes
        if self._connections > 1:
            notes.append(f"the connection was lost and made again {self._connections - 1} times")
        if self._ended_by is not None:
            notes.append(f"the source ended: {self._ended_by}")
        elif self._interrupted:
            notes.append("the source was stopped by the user")
        return tuple(notes)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Give the frames as they come, until the stream ends or :meth:`stop` is called."""
        given = 0
        frame = None if self._read is None else self._begin()
        while frame is not None or (frame := self._next()) is not None:
            if frame.index >= start:
                given += 1
                yield frame
                if given == max_frames:
                    return
            frame = None
        if not given and not self._interrupted:
            raise SourceError(self._ended_by or f"{self.name}: ends before frame {start}")

    def stop(self) -> None:
        """End the source as if its data had ended. It may be called from a signal handler."""
        self._interrupted = self._stopped = True

    def close(self) -> None:
        """End the connection. A thread that waits for a camera or a pipe ends with the process."""
        self._stopped = True
        if self._thread is not None:
            self._thread.join(2 * _POLL_S)

    def __enter__(self) -> LiveSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- the side of the consumer -----------------------------------------------------------------

    def _begin(self) -> Frame | None:
        """Begin the processing; the frame that was read before, unless some were dropped since."""
        with self._changed:
            if not self._begun:
                self._begun = True
                self._clock.begin()
            return None if self._stale else self._read

    def _next(self) -> Frame | None:
        """Wait for the next frame; None at the end."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._receive, name="live source", daemon=True)
            self._thread.start()
        if self._read is not None:
            self._begin()
        with self._changed:
            while not self._queue and not self._ended and not self._stopped:
                self._changed.wait(_POLL_S)
            if self._error is not None:
                error, self._error = self._error, None
                raise error
            # What was received before the end is processed; an interrupt does not wait for it.
            if not self._queue or self._interrupted:
                return None
            self._read, self._stale = self._queue.popleft(), False
            self._changed.notify_all()
            return self._read

    # -- the side of the thread -------------------------------------------------------------------

    def _receive(self) -> None:
        try:
            self._receive_all()
        except SourceError as error:
            if self._received:  # what was received is of use without the rest
                self._ended_by = str(error)
            else:
                self._error = error
        except BaseException as error:
            self._error = error
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _receive_all(self) -> None:
        """Receive images over one connection after the other."""
        failures = 0
        while not self._stopped:
            received = self._received
            try:
                stream = self._connect()
            except SourceError:
                if not self._connections:
                    raise
            else:
                self._connections += 1
                try:
                    self._receive_from(stream)
                finally:
                    stream.close()
            if self._pipe or self._stopped:
                return
            failures = 0 if self._received > received else failures
            if failures == self._reconnects:
                tried = f", and {failures} attempts to connect again failed" if failures else ""
                raise SourceError(f"{self.name}: no more images{tried}")
            self._pause(_FIRST_PAUSE_S * 2**failures)
            failures += 1

    def _receive_from(self, stream: Stream) -> None:
        """Receive images until the stream ends."""
        self._clock.connected()
        while not self._stopped and (received := stream.read()) is not None:
            time_s = self._clock.time_of(received)
            if time_s is None:
                continue
            index = self._received
            self._received += 1
            frame = Frame(index, time_s, f"frame-{index:06d}", received.image)
            self._check_size(frame)
            self._put(frame)

    def _put(self, frame: Frame) -> None:
        """Add a frame to the queue; the oldest one makes room, or the sender waits."""
        with self._changed:
            while len(self._queue) >= QUEUE_FRAMES and not self._stopped:
                ahead = self._clock.is_ahead(frame)
                self._keep_all |= ahead and self._pipe
                if self._keep_all or ahead or (self._pipe and not self._begun):
                    self._changed.wait(_POLL_S)
                else:
                    self._queue.popleft()
                    self.dropped += self._begun
                    self._stale |= not self._begun
            self._queue.append(frame)
            self._changed.notify_all()

    def _check_size(self, frame: Frame) -> None:
        size = frame.image.shape[1::-1]
        if frame.index == 0:
            self._size = size
        if size != self._size:
            raise SourceError(f"{self.name}: image {frame.index} is {size[0]}x{size[1]}: all sizes must be equal")

    def _pause(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while not self._stopped and time.monotonic() < until:
            time.sleep(_POLL_S)


class _Clock:
    """Makes time stamps of stated times and of times of arrival.

    * ``nominal``: Whether images without a stated time get one by a nominal rate: where the sender waits, the times of
      arrival are those of the processing.
    """

    def __init__(self, nominal: bool) -> None:
        self._nominal = nominal
        self._offset_s: float | None = None
        self._stream_s: float | None = None
        self._last_s: float | None = None
        self._lead_s = 0.0
        self._stated, self._repeated = True, 0
        self.notes: list[str] = []

    def connected(self) -> None:
        """Note that a connection was made: its times have another origin."""
        self._offset_s = self._stream_s = None
        self._repeated = 0

    def time_of(self, received: StreamImage) -> float | None:
        """Time stamp of an image that has just arrived: seconds since 1970, after the one before.

        None for an image that states no later time than the one before, as the first ones of RTSP do. After some of
        them in a row the stated times are not believed.
        """
        now_s, stream_s = time.time(), received.stream_s
        if stream_s is None and self._nominal:
            stream_s = 0.0 if self._stream_s is None else self._stream_s + 1 / NOMINAL_RATE_HZ
            self._note(f"the stream states no times: {NOMINAL_RATE_HZ:g} frames a second are assumed")
        if stream_s is None:
            self._stated = False
        elif self._stated and self._stream_s is not None and stream_s <= self._stream_s:
            self._repeated += 1
            if self._repeated <= _MAX_REPEATED:
                return None
            self._stated = False
            self._note("the times of the stream do not increase: times of arrival are taken")
        else:
            self._repeated = 0
        self._stream_s = stream_s
        if self._offset_s is None:
            self._offset_s = now_s - (stream_s or 0.0)
        time_s = self._offset_s + stream_s if self._stated and stream_s is not None else now_s
        if self._last_s is not None:
            time_s = max(time_s, self._last_s + _LEAST_STEP_S)
        self._last_s = time_s
        return time_s

    def begin(self) -> None:
        """Compare the stream with the clock from now on: its newest image is in time."""
        if self._last_s is not None:
            self._lead_s = self._last_s - time.time()

    def is_ahead(self, frame: Frame) -> bool:
        """Whether a frame has arrived before its stated time, as that of a file at full speed."""
        return self._stated and frame.timestamp_s - time.time() > self._lead_s + _JITTER_S

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)
