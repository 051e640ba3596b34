"""The tracks of a sequence, found once, stored on disk, and fed to every method from every start.

What a method learns at a frame is what a tracker that ran from the beginning knew then: where descriptors link a frame
to earlier ones, the earlier ones are stored again as they are revised, and are replayed at the frame that revised them.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from slam_init.compare.sources import calibration_of
from slam_init.types.frame import Observations

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource
    from slam_init.datasets.points import PointSource

__all__ = ["Step", "Tracks", "find_tracks", "replay"]

#: Columns of the stored tracks: raw files that are mapped into memory, so that a trial reads what it needs.
_COLUMNS: dict[str, tuple[type[np.generic], tuple[int, ...]]] = {
    "track_ids": (np.int64, ()),
    "pixels": (np.float64, (2,)),
    "bearings": (np.float64, (3,)),
    "colors": (np.uint8, (3,)),
}
_INDEX = "index.npz"
#: File names end at 255 bytes.
_LONGEST_NAME = 120


@dataclass(frozen=True, eq=False)
class Step:
    """What one frame brings: its tracks, and earlier frames of which more is known now."""

    current: Observations
    revised: tuple[Observations, ...] = ()


@dataclass(frozen=True, eq=False)
class Tracks:
    """The tracks of a sequence on disk."""

    index: dict[str, Any]
    columns: dict[str, Any]

    def steps(self, start: int) -> Iterator[Step]:
        """The frames from an absolute index on."""
        at, frames = self.index["at"], self.index["frame"]
        for frame in range(start, int(at[-1]) + 1 if len(at) else 0):
            records = np.flatnonzero(at == frame)
            found = [self._record(int(r)) for r in records if frames[r] >= start]
            current = [one for one in found if one.frame == frame]
            if current:
                yield Step(current[0], tuple(one for one in found if one.frame != frame))

    def _record(self, r: int) -> Observations:
        begin, end = int(self.index["end"][r - 1]) if r else 0, int(self.index["end"][r])
        frame = int(self.index["frame"][r])
        parts = {name: np.array(column[begin:end]) for name, column in self.columns.items()}
        return Observations(
            frame=frame,
            timestamp_s=float(self.index["timestamp_s"][r]),
            name=str(self.index["name"][r]),
            **parts,
        )


def replay(source: TimedSource | PointSource, text: str, start: int, folder: Path) -> Iterator[Step]:
    """The tracks of a source from a start on; found and stored in ``folder`` where they are not there yet."""
    from slam_init.datasets.points import PointSource

    if isinstance(source, PointSource):
        return (Step(observations) for observations in source.observations(start))
    return find_tracks(source, text, folder).steps(start)


def find_tracks(source: TimedSource, text: str, folder: Path) -> Tracks:
    """Run the tracker over a whole sequence once, or open what an earlier call stored.

    Parameters
    ----------
    source : TimedSource
        With a calibration.
    text : str
        Names the source in the folder.
    folder : Path
        Created where missing. Processes that come at the same time do the work twice, with the same result.
    """
    home = folder / quote(text, safe="")[-_LONGEST_NAME:]
    if not (home / _INDEX).is_file():
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = Path(tempfile.mkdtemp(dir=folder, prefix=".tracking-"))
        try:
            _store(source, text, unfinished)
            try:
                unfinished.rename(home)  # as a whole, or not at all
            except OSError:
                if not (home / _INDEX).is_file():  # nobody else was first
                    raise
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    return _open(home)


def _store(source: TimedSource, text: str, home: Path) -> None:
    from slam_init.config import TrackingConfig
    from slam_init.frontend.tracks import Tracker

    config = TrackingConfig()
    # The tracker looks back over the frames that descriptors are matched with, no further.
    tracker = Tracker(calibration_of(source, text), config, history_limit=config.sift_frames + 2)
    at: list[int] = []
    records: list[tuple[int, float, str]] = []
    ends: list[int] = []
    with ExitStack() as stack:
        files = {name: stack.enter_context((home / f"{name}.raw").open("wb")) for name in _COLUMNS}
        for frame in source.frames():
            current = tracker.track(frame)
            for one in (current, *tracker.revised):
                at.append(frame.index)
                records.append((one.frame, one.timestamp_s, one.name))
                ends.append((ends[-1] if ends else 0) + len(one))
                for name, (kind, _) in _COLUMNS.items():
                    files[name].write(np.ascontiguousarray(getattr(one, name), kind).tobytes())
            tracker.history.forget(keep=())
    frames, times, names = zip(*records, strict=True) if records else ((), (), ())
    with (home / _INDEX).open("wb") as file:
        np.savez(
            file,
            at=np.array(at, np.int64),
            frame=np.array(frames, np.int64),
            timestamp_s=np.array(times, float),
            name=np.array(names, np.str_),
            end=np.array(ends, np.int64),
        )


def _open(home: Path) -> Tracks:
    with np.load(home / _INDEX) as stored:
        index = {name: stored[name] for name in stored.files}
    total = int(index["end"][-1]) if len(index["end"]) else 0
    columns: dict[str, Any] = {}
    for name, (kind, shape) in _COLUMNS.items():
        # An empty file cannot be mapped.
        empty = np.zeros((0, *shape), kind)
        columns[name] = np.memmap(home / f"{name}.raw", kind, "r", shape=(total, *shape)) if total else empty
    return Tracks(index, columns)
