"""Tracks of a sequence: computed once, stored on disk, and replayed for every method from every start.

At each frame a method gets the tracks that a tracker knows at this frame if it has run from the first frame on. The
tracker can revise earlier frames when descriptors link the current frame to them. The revised frames are stored as
well, and they are replayed at the frame at which they were revised.
"""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile
from urllib.parse import quote
from zipfile import ZipFile

import numpy as np

from slam_init.compare.sources import AnySource, calibration_of
from slam_init.datasets.track_source import TrackSource
from slam_init.types.frame import Observations, TimedSource

#: Tracks of a frame whose positions are hashed.
_HASHED_TRACKS = 20
#: Largest length of a file name in characters; file systems allow 255 bytes.
_MAX_NAME = 120


@dataclass(frozen=True, eq=False)
class Step:
    """The tracks that become known at one frame."""

    #: Tracks of the frame itself.
    current: Observations
    #: Earlier frames whose tracks were revised at this frame.
    revised: tuple[Observations, ...] = ()


def replay(source: AnySource, text: str, start: int, folder: str | os.PathLike[str]) -> Iterator[Step]:
    """Replay the tracks of a source from a start frame on. Revised frames before the start are left out.

    * ``folder``: Folder of the stored tracks. The tracks are computed and stored if they are not there yet. A source of
      points knows its tracks and does not use the folder, nor does a source of given tracks.
    """
    if isinstance(source, TrackSource):
        yield from (Step(observations) for observations in source.observations(start))
        return
    with ZipFile(_stored(source, text, folder)) as archive:
        for name in archive.namelist():
            if int(name) >= start:
                step: Step = pickle.loads(archive.read(name))  # this program wrote the file
                yield Step(step.current, tuple(one for one in step.revised if one.frame >= start))


def _stored(source: TimedSource, text: str, folder: str | os.PathLike[str]) -> Path:
    """Run the tracker over a whole sequence, or find the tracks that an earlier call stored; return their file.

    If two processes call this function at the same time, both do the work and the result is the same.
    """
    from slam_init import Initializer

    file = Path(folder) / f"{quote(text, safe='')[-_MAX_NAME:]}.zip"
    if file.is_file():
        return file
    file.parent.mkdir(parents=True, exist_ok=True)
    tracker = Initializer(calibration_of(source, text)).tracker
    with NamedTemporaryFile(dir=file.parent, delete=False) as unfinished, ZipFile(unfinished, "w") as archive:
        for frame in source.frames():
            step = Step(tracker.track(frame), tuple(tracker.revised))
            archive.writestr(str(frame.index), pickle.dumps(step))
            tracker.history.forget(keep=())
    Path(unfinished.name).replace(file)  # atomic: the file appears as a whole
    return file


def tracks_digest(source: AnySource, text: str, steps: Iterable[Step]) -> str:
    """Hash the tracks of a source, so that two comparisons can check whether they evaluated the same input.

    The hash holds the calibration, and of each record its frame, the ids of all tracks, and the positions of about 20
    tracks, rounded to a hundredth of a pixel. The last bit of a sine differs between processors and libraries, so that
    a hash of all bits would differ as well. With 20 tracks a rounding differs by chance in one of a million sources.
    """
    camera = calibration_of(source, text)
    stated = f"{camera.model} {camera.width} {camera.height} {[f'{n:.6g}' for n in camera.parameters]}"
    digest = hashlib.sha256(stated.encode())
    for step in steps:
        for one in (step.current, *step.revised):
            sampled = one.pixels[:: max(1, len(one) // _HASHED_TRACKS)]
            digest.update(f"{one.frame} {len(one)}".encode())
            digest.update(np.ascontiguousarray(one.track_ids, "<i8").tobytes())
            digest.update(np.round(100 * sampled).astype("<i8").tobytes())
    return digest.hexdigest()[:16]
