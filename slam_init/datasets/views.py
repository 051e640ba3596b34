"""Sources that are made of another source: with other times, fewer frames, masked pixels, gravity.

As in COLMAP, the black pixels (0) of a mask are ignored, and the mask of ``NAME.EXT`` is ``NAME.EXT.png`` in the
folder; ``NAME.png`` is found as well. Frames of a video are named ``frame-000012``.

Gravity is of a table, or of an accelerometer at rest. A line of a table is ``TIME x y z`` or ``NAME x y z``,
with commas or spaces: the time stamp of the frame in seconds, of which the nearest one within 20 ms is taken, or the
name of its file; and a vector down in the axes of the camera (x right, y down, z forward), of any length but zero. A
fifth column states its standard deviation, by default 1 degree.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlencode

import numpy as np

from slam_init.calibration.files import load_camera
from slam_init.datasets.image_files import GreyLevels, ImageFileSource, frame_range, read_image
from slam_init.datasets.synth import SynthSource
from slam_init.datasets.text import fields_of, numbers, read_rows
from slam_init.errors import SlamInitError, SourceError
from slam_init.system.regular_file import user_path
from slam_init.types.arrays import Floats, Image, Ints
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, TimedSource, notes_of
from slam_init.types.inertial import Gravity, InertialRecord


def _of_source(name: str, *default: None) -> Any:
    """A property that is that of the source."""
    return property(lambda derived: getattr(derived.source, name, *default), doc="That of the source.")


@dataclass(frozen=True, eq=False)
class DerivedSource:
    """A :class:`slam_init.types.frame.TimedSource` that is like another one, but for what a subclass changes."""

    source: TimedSource

    name, kind, camera = _of_source("name"), _of_source("kind"), _of_source("camera")
    groundtruth, timestamps_s = _of_source("groundtruth"), _of_source("timestamps_s")
    gyroscope, inertial, left = (_of_source(name, None) for name in ("gyroscope", "inertial", "left"))

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source."""
        return notes_of(self.source)

    def __len__(self) -> int:
        return len(self.source)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Give the frames of the source."""
        yield from self.source.frames(start, max_frames)


#: Time stamps are exact to this.
_ROUNDING_S = 1e-6


def _paced(times_s: Floats, fps: float) -> Iterator[int]:
    """The frames that are nearest to regular instants.

    Each is the first one that is later than an instant, or earlier by half a frame at most.
    """
    interval_s = 1 / fps
    steps_s = np.minimum(np.diff(times_s, prepend=times_s[:1]), interval_s)
    # Times are rounded to microseconds in some containers; without this a frame in the middle would be a lottery.
    ahead_s = times_s + steps_s / 2 + _ROUNDING_S
    due_s = times_s[0] if len(times_s) else 0.0
    for index in range(len(times_s)):
        if ahead_s[index] >= due_s:
            yield index
            # Several instants within one frame interval count as one: no frame is given twice.
            due_s += interval_s * (np.floor((ahead_s[index] - due_s) / interval_s) + 1)


@dataclass(frozen=True, eq=False)
class SubsampledSource(DerivedSource):
    """A part of the frames of a source. Frames keep their time stamps and, unless renumbered, their indices."""

    #: Every N-th frame is included, from the start frame on.
    every: int = 1
    #: The frames nearest to this rate are included, by their time stamps, from the start frame on. A source with a
    #: lower rate gives all frames.
    fps: float | None = None
    #: Whether the frames that are included from frame 0 on get consecutive indices, as a comparison needs them.
    renumbered: bool = False

    def __post_init__(self) -> None:
        if self.every < 1:
            raise SourceError(f"every {self.every} frames: give 1 or more")
        if self.fps is not None and not 0 < self.fps < np.inf:
            raise SourceError(f"{self.fps!r} frames a second: give a positive number")

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source, and which frames are included."""
        rate = f"every {self.every} frames one is" if self.fps is None else f"at most {self.fps:g} frames a second are"
        return (*notes_of(self.source), f"{rate} used")

    @cached_property
    def timestamps_s(self) -> Floats:
        """(N,) float: time stamps of the frames that are included from frame 0 on."""
        times_s = self.source.timestamps_s
        return times_s[self._included[self._included < len(times_s)]]  # a bag may hold fewer frames than its index says

    @cached_property
    def _included(self) -> Ints:
        """Absolute indices of the frames that are included from frame 0 on."""
        return self._indices(0)

    def _indices(self, start: int) -> Ints:
        if self.fps is None:
            return np.arange(start, len(self.source), self.every)
        return start + np.array(list(_paced(self.source.timestamps_s[start:], self.fps)), int)

    def __len__(self) -> int:
        return len(self._included)

    def left(self, start: int) -> int:
        """Count the frames that are included from a frame on."""
        return len(self) - start if self.renumbered else len(self._indices(start))

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read the frames that are included, in order.

        * ``start``: Absolute index of the first frame; for renumbered frames their own number.
        """
        wanted = frame_range(len(self if self.renumbered else self.source), start, max_frames, self.name)
        indices = self._included[wanted] if self.renumbered else self._indices(start)[:max_frames]
        for number, frame in enumerate(self._read(indices.tolist()), start):
            yield replace(frame, index=number) if self.renumbered else frame

    def _read(self, indices: list[int]) -> Iterator[Frame]:
        if isinstance(self.source, ImageFileSource | SynthSource):
            for index in indices:
                yield from self.source.frames(index, 1)
            return
        # A video decodes all frames before one.
        wanted = set(indices)
        for frame in self.source.frames(indices[0], indices[-1] - indices[0] + 1):
            if frame.index in wanted:
                yield frame


@dataclass(frozen=True, eq=False)
class MaskedSource(DerivedSource):
    """A source whose frames have masks.

    * ``source``: Gives the frames.
    """

    #: An image for all frames, or a folder.
    path: Path

    def __post_init__(self) -> None:
        if not self.path.exists():
            raise SourceError(f"{self.path}: no such file or folder of masks")

    @cached_property
    def _of_all(self) -> Image | None:
        """(H, W) The mask of all frames; None for a folder."""
        return None if self.path.is_dir() else read_mask(self.path)

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source, and what the mask ignores."""
        notes = notes_of(self.source)
        if self._of_all is None:
            return (*notes, f"the masks in {self.path.name} are ignored pixels of the frames")
        return (*notes, f"the mask {self.path.name} ignores {np.mean(self._of_all == 0):.1%} of each image")

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read frames in order, with their masks."""
        for frame in self.source.frames(start, max_frames):
            mask, path = (self._of_all, self.path) if self._of_all is not None else self._of(frame)
            size, expected = mask.shape[::-1], frame.image.shape[1::-1]
            if size != expected:
                sizes = f"the mask is {size[0]}x{size[1]}, but the frame {frame.name} is {expected[0]}x{expected[1]}"
                raise SourceError(f"{path}: {sizes}: give a mask of the size of the frames")
            yield replace(frame, mask=mask)

    def _of(self, frame: Frame) -> tuple[Image, Path]:
        names = (f"{frame.name}.png", f"{os.path.splitext(frame.name)[0]}.png")  # noqa: PTH122 (a Path drops "./")
        found = next((self.path / name for name in names if (self.path / name).exists()), None)
        if found is None:
            looked_for = " or ".join(dict.fromkeys(names))
            raise SourceError(f"{self.path}: no mask for the frame {frame.name}: add {looked_for}, or give one for all")
        return read_mask(found, self.path), found


def read_mask(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Image:
    """Read a mask.

    Shapes: returns (H, W).

    * ``path``: An image; of a coloured one, pixels that are black in all channels are ignored. Of 16 bits all count.
    """
    image = read_image(path, root, GreyLevels(0, 255))
    bright = image if image.ndim == 2 else image.max(axis=2)
    return np.where(bright > 0, np.uint8(255), np.uint8(0))


@dataclass(frozen=True, eq=False)
class CalibratedSource(DerivedSource):
    """A source with a calibration that is given beside it."""

    given: Camera

    @property
    def camera(self) -> Camera:
        """The given one."""
        return self.given


_PREFIX = "view?"


@dataclass(frozen=True)
class SourceView:
    """The frames and pixels of a source that are used, by default all; and their calibration."""

    #: Every N-th frame, from the start frame on.
    every: int = 1
    #: The frames nearest to this rate.
    fps: float | None = None
    #: A mask for all frames, or a folder of masks.
    mask: str | None = None
    #: A calibration as of :func:`slam_init.load_camera`, in the place of that of the source.
    camera: str | None = None

    def __post_init__(self) -> None:
        if self.every != 1 and self.fps is not None:
            raise SourceError(f"every {self.every} frames and {self.fps:g} frames a second: give one of both")

    def apply(self, source: TimedSource, *, renumbered: bool = False) -> TimedSource:
        """Limit a source to the frames and pixels that are used."""
        if self.every != 1 or self.fps is not None:
            source = SubsampledSource(source, self.every, self.fps, renumbered)
        if self.mask is not None:
            source = MaskedSource(source, user_path(self.mask))
        if self.camera is None:
            return source
        height, width = next(source.frames(0, 1)).image.shape[:2]
        return CalibratedSource(source, load_camera(self.camera, (width, height)))

    @property
    def query(self) -> str:
        """The options that differ from the defaults, as in ``every=3&mask=car.png``; empty where all is used."""
        every = None if self.every == 1 else self.every
        options = {"every": every, "fps": self.fps, "mask": self.mask, "camera": self.camera}
        return urlencode({name: value for name, value in options.items() if value is not None})

    def text(self, source: str) -> str:
        """Name a source with this view in one text.

        * Returns: The source itself where all is used; else a text that :meth:`parse` takes apart.
        """
        return f"{_PREFIX}{self.query}:{source}" if self.query else source

    @classmethod
    def parse(cls, text: str) -> tuple[SourceView, str]:
        """Take a text apart that :meth:`text` made."""
        if not text.startswith(_PREFIX):
            return cls(), text
        query, _, source = text.removeprefix(_PREFIX).partition(":")  # a colon in a value is written as %3A
        options = dict(parse_qsl(query))
        fps = float(options["fps"]) if "fps" in options else None
        return cls(int(options.get("every", 1)), fps, options.get("mask"), options.get("camera")), source


# -- gravity ---------------------------------------------------------------------------------------


#: Half of the interval between two frames of a video.
#: Class: geometry.
_NEAR_S = 0.02
_SIGMA_DEG = 1.0


@dataclass(frozen=True, eq=False)
class GravitySource(DerivedSource):
    """A source whose frames have the direction of gravity.

    * ``source``: Gives the frames.
    """

    #: Gives the gravity in a frame, or None where it is not known.
    gravity_of: Callable[[Frame], Gravity | None]
    note: str = "the frames have gravity of a function"
    #: Frames read last, with gravity and in all.
    _count: list[int] = field(default_factory=lambda: [0, 0])

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source, where gravity is from, and how many of the frames that were read last have it."""
        known, total = self._count
        return (*notes_of(self.source), f"{self.note}: {known} of {total}" if total else self.note)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read frames in order, with gravity."""
        self._count[:] = 0, 0
        for frame in self.source.frames(start, max_frames):
            gravity = self.gravity_of(frame)
            self._count[0] += gravity is not None
            self._count[1] += 1
            yield replace(frame, gravity=gravity)


def at_rest(record: InertialRecord) -> Callable[[Frame], Gravity | None]:
    """Make the function that gives gravity in the frames during which an accelerometer is at rest."""
    return lambda frame: record.gravity_at(frame.timestamp_s)


def read_gravity(path: str | os.PathLike[str]) -> Callable[[Frame], Gravity | None]:
    """Read a table, and make the function that gives gravity in a frame of it."""
    table = user_path(path)
    named: dict[str, Gravity] = {}
    timed: dict[float, Gravity] = {}
    for row in read_rows(table):
        key, *fields = fields_of(row)
        values = numbers(row, fields, 4 if len(fields) > 3 else 3, "TIME or NAME, x, y, z and perhaps degrees")
        try:
            gravity = Gravity(np.array(values[:3]), *(values[3:] or [_SIGMA_DEG]))
        except SlamInitError as error:
            raise SourceError(f"{row[0]}: {error}") from None
        try:
            timed[float(key)] = gravity
        except ValueError:
            named[key] = gravity
    if not (named or timed):
        raise SourceError(f"{table}: holds no direction of gravity: write lines of TIME x y z or NAME x y z")
    if not all(map(math.isfinite, timed)):
        raise SourceError(f"{table}: a time stamp is not finite: give seconds")

    def gravity_of(frame: Frame) -> Gravity | None:
        if frame.name in named or not timed:
            return named.get(frame.name)
        nearest = min(timed, key=lambda time_s: abs(time_s - frame.timestamp_s))
        return timed[nearest] if abs(nearest - frame.timestamp_s) <= _NEAR_S else None

    return gravity_of
