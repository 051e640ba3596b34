"""Tracks of a sequence: computed once, stored on disk, and replayed for every method from every start.

At each frame a method gets the tracks that a tracker knows at this frame if it has run from the first frame on. The
tracker can revise earlier frames when descriptors link the current frame to them. The revised frames are stored as
well, and they are replayed at the frame at which they were revised.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from slam_init.compare.sources import calibration_of
from slam_init.types.arrays import Floats, Image, Ints
from slam_init.types.frame import Observations

if TYPE_CHECKING:
    from slam_init.datasets import TimedSource
    from slam_init.datasets.points import PointSource

#: Columns of the stored tracks. Each is a raw file that is mapped into memory, so that a trial reads only the part that
#: it needs.
_COLUMNS: dict[str, tuple[type[np.generic], tuple[int, ...]]] = {
    "track_ids": (np.int64, ()),
    "pixels": (np.float64, (2,)),
    "bearings": (np.float64, (3,)),
    "colors": (np.uint8, (3,)),
    "drifts": (np.float64, (2, 2)),
}
#: How often the tracks are made anew where the folder disappears meanwhile.
_TRIES = 3
_INDEX = "index.npz"
#: Tracks of a frame whose positions are hashed.
_HASHED_TRACKS = 20
#: Largest length of a folder name in characters; file systems allow 255 bytes.
_MAX_NAME = 120


@dataclass(frozen=True, eq=False)
class Step:
    """The tracks that become known at one frame."""

    #: Tracks of the frame itself.
    current: Observations
    #: Earlier frames whose tracks were revised at this frame.
    revised: tuple[Observations, ...] = ()


@dataclass(frozen=True, eq=False)
class Tracks:
    """The tracks of a sequence on disk: R records, one for each frame and each revision of a frame."""

    #: (R,) Absolute index of the frame at which a record is replayed.
    at: Ints
    #: (R,) Absolute index of the frame that the record describes.
    frame: Ints
    #: (R,) Time stamp of this frame in seconds.
    timestamp_s: Floats
    #: (R,) Standard deviation of the last step of its tracks.
    step_px: Floats
    #: (R,) Exposure time of this frame in seconds.
    exposure_s: Floats
    #: (R,) Name of this frame.
    name: NDArray[np.str_]
    #: (R,) End of the rows of the record in the columns; the rows begin at the end of the record before.
    end: Ints
    #: (N,) Column of the track ids. All columns are mapped into memory.
    track_ids: Ints
    #: (N, 2) Column of the raw pixels.
    pixels: Floats
    #: (N, 3) Column of the bearings.
    bearings: Floats
    #: (N, 3) Column of the colours.
    colors: Image
    #: (N, 2, 2) Column of the drifts.
    drifts: Floats

    def steps(self, start: int) -> Iterator[Step]:
        """Replay the tracks.

        * Returns: One for each frame from ``start`` on. Revised frames before ``start`` are left out.
        """
        at, frames = self.at, self.frame  # the records are in the order of `at`
        first = int(np.searchsorted(at, start))
        for frame, records in groupby(range(first, len(at)), key=at.__getitem__):
            found = [self._record(r) for r in records if frames[r] >= start]
            current = [one for one in found if one.frame == frame]
            if current:
                yield Step(current[0], tuple(one for one in found if one.frame != frame))

    def _record(self, r: int) -> Observations:
        rows = slice(int(self.end[r - 1]) if r else 0, int(self.end[r]))
        return Observations(
            frame=int(self.frame[r]),
            timestamp_s=float(self.timestamp_s[r]),
            name=str(self.name[r]),
            track_ids=np.array(self.track_ids[rows]),
            pixels=np.array(self.pixels[rows]),
            bearings=np.array(self.bearings[rows]),
            colors=np.array(self.colors[rows]),
            drifts=np.array(self.drifts[rows]),
            step_px=float(self.step_px[r]),
            exposure_s=float(self.exposure_s[r]),
        )


def replay(source: TimedSource | PointSource, text: str, start: int, folder: str | os.PathLike[str]) -> Iterator[Step]:
    """Replay the tracks of a source from a start frame on.

    * ``folder``: Folder of the stored tracks. The tracks are computed and stored if they are not there yet. A source of
      points knows its tracks and does not use the folder, nor does a source of given tracks.
    """
    from slam_init.datasets.points import PointSource
    from slam_init.datasets.track_source import TrackSource

    if isinstance(source, PointSource | TrackSource):
        return (Step(observations) for observations in source.observations(start))
    return find_tracks(source, text, folder).steps(start)


def tracks_digest(source: TimedSource | PointSource, steps: Iterable[Step]) -> str:
    """Hash the tracks of a source, so that two comparisons can tell whether they judged the same input.

    The hash holds the calibration, and of each record its frame, the ids of all tracks, and the positions of about 20
    tracks, rounded to a hundredth of a pixel. The last bit of a sine differs between processors and libraries, so that
    a hash of all bits would differ as well. With 20 tracks a rounding differs by chance in one of a million sources.
    """
    digest = hashlib.sha256()
    camera = source.camera
    if camera is not None:
        numbers = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
        digest.update(f"{camera.model} {camera.width} {camera.height} {[f'{n:.6g}' for n in numbers]}".encode())
    for step in steps:
        for one in (step.current, *step.revised):
            sampled = one.pixels[:: max(1, len(one) // _HASHED_TRACKS)]
            digest.update(f"{one.frame} {len(one)}".encode())
            digest.update(np.ascontiguousarray(one.track_ids, "<i8").tobytes())
            digest.update(np.round(100 * sampled).astype("<i8").tobytes())
    return digest.hexdigest()[:16]


def find_tracks(source: TimedSource, text: str, folder: str | os.PathLike[str]) -> Tracks:
    """Run the tracker over a whole sequence, or open the tracks that an earlier call stored.

    * ``folder``: Created if it does not exist. If two processes call this function at the same time, both do the work
      and the result is the same.
    """
    home = Path(folder) / quote(text, safe="")[-_MAX_NAME:]
    for _ in range(_TRIES - 1):
        try:
            return _found(source, text, home)
        except FileNotFoundError:  # the process that had made the folder has ended and removed it: make it anew
            continue
    return _found(source, text, home)


def _found(source: TimedSource, text: str, home: Path) -> Tracks:
    if not (home / _INDEX).is_file():
        home.parent.mkdir(parents=True, exist_ok=True)
        unfinished = Path(tempfile.mkdtemp(dir=home.parent, prefix=".tracking-"))
        try:
            _store(source, text, unfinished)
            try:
                unfinished.rename(home)  # atomic: the folder appears with all its files or not at all
            except OSError:
                if not (home / _INDEX).is_file():  # no other process stored the tracks first
                    raise
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    return _open(home)


def _store(source: TimedSource, text: str, home: Path) -> None:
    from slam_init.config import TrackingConfig
    from slam_init.frontend.tracks import Tracker

    config = TrackingConfig()
    # The tracker needs only the frames that descriptors are matched with.
    tracker = Tracker(calibration_of(source, text), config, history_limit=config.sift_frames + 2)
    at: list[int] = []
    records: list[tuple[int, float, float, float, str]] = []
    ends: list[int] = []
    with ExitStack() as stack:
        files = {name: stack.enter_context((home / f"{name}.raw").open("wb")) for name in _COLUMNS}
        for frame in source.frames():
            current = tracker.track(frame)
            for one in (current, *tracker.revised):
                at.append(frame.index)
                records.append((one.frame, one.timestamp_s, one.step_px, one.exposure_s, one.name))
                ends.append((ends[-1] if ends else 0) + len(one))
                for name, (kind, _) in _COLUMNS.items():
                    files[name].write(np.ascontiguousarray(getattr(one, name), kind).tobytes())
            tracker.history.forget(keep=())
    frames, times, steps, exposures, names = zip(*records, strict=True) if records else ((), (), (), (), ())
    with (home / _INDEX).open("wb") as file:
        np.savez(
            file,
            at=np.array(at, np.int64),
            frame=np.array(frames, np.int64),
            timestamp_s=np.array(times, float),
            step_px=np.array(steps, float),
            exposure_s=np.array(exposures, float),
            name=np.array(names, np.str_),
            end=np.array(ends, np.int64),
        )


def _open(home: Path) -> Tracks:
    with np.load(home / _INDEX) as stored:
        index = {name: stored[name] for name in stored.files}
    total = int(index["end"][-1]) if len(index["end"]) else 0
    columns: dict[str, np.ndarray] = {}
    for name, (kind, shape) in _COLUMNS.items():
        # An empty file cannot be mapped into memory.
        empty = np.zeros((0, *shape), kind)
        columns[name] = np.memmap(home / f"{name}.raw", kind, "r", shape=(total, *shape)) if total else empty
    return Tracks(**index, **columns)
