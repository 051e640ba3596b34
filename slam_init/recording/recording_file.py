"""The file of a recording, which Rerun writes while the recording is made.

Rerun reports a full disk in its log only, and a flush may then wait without end. So the space of the disk is looked up
with each frame, and a recording ends with an error before the disk is full.
"""

from __future__ import annotations

import errno
import os
import shutil
import uuid
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from slam_init.output.folder import writing
from slam_init.output.names import UNFINISHED

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_CHUNK_BYTES = 1 << 19
#: Space that a recording leaves on its disk: the chunks that Rerun has not written yet.
_RESERVE_BYTES = 16 * _CHUNK_BYTES


def open_stream(application: str, identity: str, viewer: str | None = None) -> rr.RecordingStream:
    """Open a stream without a wall clock and with an id that depends on its arguments only.

    A chunk ends after a number of bytes and never after a time, so that two equal runs write equal chunks. For a
    viewer that shows the stream while it is made, chunks end by time.
    """
    import rerun as rr

    batching = rr.ChunkBatcherConfig.NEVER() if viewer is None else rr.ChunkBatcherConfig.LOW_LATENCY()
    if viewer is None:
        batching.flush_num_bytes = _CHUNK_BYTES
    name = uuid.uuid5(uuid.NAMESPACE_URL, identity)
    rec = rr.RecordingStream(application, recording_id=name, send_properties=False, batcher_config=batching)
    rec.set_log_time_enabled(False)
    rec.set_log_tick_enabled(False)
    return rec


class RecordingFile:
    """A file that receives a recording while it is made. It has another name until it is complete.

    * ``path``: The file; an existing one is replaced when the recording is complete.
    * ``recording``: The stream. Its data up to now and all further data go to the file.
    * ``layout``: The layout in the viewer.
    * ``viewer``: Address of a viewer that receives the same data.
    """

    def __init__(
        self, path: Path, recording: rr.RecordingStream, layout: rrb.Blueprint, viewer: str | None = None
    ) -> None:
        import rerun as rr

        self._path, self._partial = path, path.with_suffix(UNFINISHED)
        self._recording, self.is_open = recording, True
        with self._writing():
            if path.is_dir():
                raise IsADirectoryError(f"{path} is a folder")
            _check_room(path.parent)
            self._partial.touch()
        sinks = [] if viewer is None else [rr.GrpcSink(viewer)]
        recording.set_sinks(rr.FileSink(str(self._partial)), *sinks, default_blueprint=layout)

    def check(self) -> None:
        """Raise an error where the disk is full, or the file is gone."""
        with self._writing():
            if self.is_open and not self._partial.exists():
                raise FileNotFoundError("the file is gone")
            _check_room(self._path.parent)

    def complete(self) -> None:
        """Write the rest, close the file, and give it its name. It may be called twice."""
        if self.is_open:
            try:
                self.check()
                self._recording.disconnect()
                with self._writing():
                    self._partial.replace(self._path)
            finally:
                self.discard()

    def discard(self) -> None:
        """Close the file, and remove it unless it is complete."""
        if self.is_open:
            self._recording.disconnect()
        self.is_open = False
        with suppress(OSError):
            self._partial.unlink(missing_ok=True)

    def _writing(self) -> AbstractContextManager[None]:
        return writing(f"the recording {self._path}", "give another --out")


def _check_room(folder: Path) -> None:
    if shutil.disk_usage(folder).free < _RESERVE_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
