"""The file of a recording. Rerun writes to a pipe, and two threads copy the pipe to the file.

Rerun's own writer reports a full disk only in its log, and its thread ends there. A later flush has waited for this
thread without end: at 64 kB of free space, in some runs. Here one thread reads the pipe, whatever the disk does, so
that Rerun never waits. The other thread writes to the file, and keeps the error of the disk for the caller. A disk that
takes no data is an error as well.
"""

from __future__ import annotations

import os
import threading
import uuid
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING

from slam_init.errors import OutputError
from slam_init.output.folder import remedy
from slam_init.output.names import UNFINISHED

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_PIPES = Path("/dev/fd")
_READ_BYTES = 1 << 18
_CHUNK_BYTES = 1 << 19
#: Data that waits for the disk. It takes minutes to record so much.
_MAX_WAITING_BYTES = 1 << 28


def open_stream(application: str, identity: str, viewer: str | None = None) -> rr.RecordingStream:
    """Open a stream without a wall clock and with an id that depends on its arguments only.

    A chunk ends after a number of bytes and never after a time, so that two equal runs write equal chunks. For a
    viewer that shows the stream while it is made, chunks end by time.
    """
    import rerun as rr

    batching = rr.ChunkBatcherConfig.NEVER() if viewer is None else rr.ChunkBatcherConfig.LOW_LATENCY()
    if viewer is None:
        batching.flush_num_bytes = _CHUNK_BYTES
    rec = rr.RecordingStream(
        application,
        recording_id=uuid.uuid5(uuid.NAMESPACE_URL, identity),
        send_properties=False,
        batcher_config=batching,
    )
    rec.set_log_time_enabled(False)
    rec.set_log_tick_enabled(False)
    return rec


class RecordingFile:
    """A file that receives a recording while it is made. It has another name until it is complete.

    * ``path``: The file; an existing one is replaced when the recording is complete.
    * ``recording``: The stream. Its data up to now and all further data go to the file.
    * ``layout``: The layout in the viewer.
    * ``viewer``: Address of a viewer that receives the same data.
    * ``patience_s``: At the end, a disk that takes no data for this long has failed.
    """

    def __init__(
        self,
        path: Path,
        recording: rr.RecordingStream,
        layout: rrb.Blueprint,
        viewer: str | None = None,
        patience_s: float = 60.0,
    ) -> None:
        self._path, self._partial = path, path.with_suffix(UNFINISHED)
        self._recording = recording
        self._patience_s = patience_s
        self._error: BaseException | None = None
        self._thread: threading.Thread | None = None
        self._queue: SimpleQueue[bytes] = SimpleQueue()
        self._read_bytes = self._written_bytes = 0  # each is changed by one thread
        self._open = True
        try:
            if path.is_dir():
                raise IsADirectoryError(f"{path} is a folder")
            file = self._partial.open("wb", buffering=0)
        except OSError as error:
            raise self._failure(error) from error
        if not _PIPES.is_dir():  # a system without names for open files: Rerun writes the file
            file.close()
            _send(recording, self._partial, viewer, layout)
            return
        read, write = os.pipe()
        threading.Thread(target=self._read, args=(read,), daemon=True).start()
        self._thread = threading.Thread(target=self._write, args=(file.fileno(),), daemon=True)
        self._file = file  # open until the thread has ended
        self._thread.start()
        try:
            _send(recording, _PIPES / str(write), viewer, layout)
        finally:
            os.close(write)  # Rerun has opened the pipe again

    def check(self) -> None:
        """Raise the error of the disk, if there was one."""
        if self._error is None and self._open and not self._partial.exists():
            self._error = FileNotFoundError("the file is gone")
        if self._error is not None:
            raise self._failure(self._error) from self._error

    def complete(self) -> None:
        """Write the rest, close the file, and give it its name. It may be called twice."""
        if not self._open:
            return
        self._close()
        try:
            self.check()
            self._partial.replace(self._path)
        except OSError as error:
            raise self._failure(error) from error
        finally:
            with suppress(OSError):
                self._partial.unlink(missing_ok=True)

    def discard(self) -> None:
        """Close the file and remove it."""
        if self._open:
            self._close()
            with suppress(OSError):
                self._partial.unlink(missing_ok=True)

    def _close(self) -> None:
        self._open = False
        self._recording.disconnect()
        if self._thread is None:
            return
        written = -1
        while self._thread.is_alive() and written < self._written_bytes:
            written = self._written_bytes
            self._thread.join(self._patience_s)
        if self._thread.is_alive():
            self._error = TimeoutError(f"the disk took no data for {self._patience_s:g} s")
        else:
            self._file.close()

    def _read(self, pipe: int) -> None:
        """Take all data of Rerun. After an error of the disk they are dropped."""
        while data := os.read(pipe, _READ_BYTES):
            self._read_bytes += len(data)
            if self._error is None and self._read_bytes - self._written_bytes > _MAX_WAITING_BYTES:
                self._error = TimeoutError("the disk is too slow")
            if self._error is None:
                self._queue.put(data)
        os.close(pipe)
        self._queue.put(b"")

    def _write(self, file: int) -> None:
        while data := self._queue.get():
            try:
                while self._error is None and data:
                    written = os.write(file, data)
                    data = data[written:]
                    self._written_bytes += written
            except BaseException as error:
                self._error = error

    def _failure(self, error: BaseException) -> OutputError:
        cause = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return OutputError(f"cannot write the recording {self._path}: {cause}: {remedy(error)}, or give another --out")


def _send(recording: rr.RecordingStream, path: Path, viewer: str | None, layout: rrb.Blueprint) -> None:
    """Send the data of a recording to a file, and to a viewer if there is one."""
    if viewer is None:
        recording.save(path, default_blueprint=layout)
        return
    import rerun as rr

    recording.set_sinks(rr.FileSink(str(path)), rr.GrpcSink(viewer), default_blueprint=layout)
