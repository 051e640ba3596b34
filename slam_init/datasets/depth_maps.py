"""Sources whose frames have depths from elsewhere: a folder of depth images, or a function.

The depth of the frame ``NAME.EXT`` is ``NAME.EXT.png``, ``NAME.png`` (16 bits, or 8), ``NAME.npz`` or ``NAME.npy``.
That of ``NAME.color.EXT`` is ``NAME.depth.png`` (7-Scenes). Where the names are times in seconds (TUM), it is the
nearest one within 20 ms.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from slam_init.datasets.bounded import read_npy, read_npz
from slam_init.datasets.image_files import decode_image
from slam_init.datasets.views import DerivedSource
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside, read_regular, user_path
from slam_init.types.arrays import Floats
from slam_init.types.depth import Depth, DepthKind
from slam_init.types.frame import Frame, notes_of

#: Depth and colour of a Kinect are up to half a frame apart.
#: Class: geometry.
_NEAR_S = 0.02
_MAX_BYTES = 400_000_000
#: 7-Scenes writes this where nothing is known.
_NONE_16 = 65535


@dataclass(frozen=True, eq=False)
class DepthSource(DerivedSource):
    """A source whose frames have depths.

    * ``source``: Gives the frames.
    """

    #: Gives the depth of a frame, or None where there is none.
    depth_of: Callable[[Frame], Depth | None]
    note: str = "the frames have depths of a function"

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source, and where the depths are from."""
        return (*notes_of(self.source), self.note)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read frames in order, with their depths."""
        for frame in self.source.frames(start, max_frames):
            yield replace(frame, depth=self.depth_of(frame))


class DepthFolder:
    """Gives the depths of frames from a folder. A frame without a file has none, but for the first one.

    * ``path``: The folder.
    * ``kind``: That of all files.
    * ``factor``: The value of one unit of an integer image: 5000 for TUM's, 1000 for millimetres.
    * ``sigma``: Relative standard deviation.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        kind: DepthKind | str = DepthKind.METRIC,
        factor: float = 1000.0,
        sigma: float = 0.1,
    ) -> None:
        self._path, self._kind, self._factor, self._sigma = user_path(path), kind, factor, sigma
        self._found = False
        if not self._path.is_dir():
            raise SourceError(f"{path}: no such folder of depths")
        if not (np.isfinite(factor) and factor > 0):
            raise SourceError(f"the factor of the depths is {factor!r}: give a positive number")

    @property
    def note(self) -> str:
        """Where the depths are from."""
        return f"the frames have depths from {self._path.name} ({self._kind})"

    def __call__(self, frame: Frame) -> Depth | None:
        """The depth of a frame."""
        path = self._file_of(frame)
        if path is not None:
            self._found = True
            return Depth(read_depth(path, self._path, self._factor), self._kind, self._sigma)
        if not self._found:
            raise SourceError(
                f"{self._path}: no depth for the frame {frame.name}: name the files as the frames (.png, .npz, .npy), "
                "or by their times in seconds"
            )
        return None

    def _file_of(self, frame: Frame) -> Path | None:
        stem = frame.name.removesuffix(Path(frame.name).suffix)
        stems = (frame.name, stem, f"{stem.removesuffix('.color')}.depth")
        for name in (f"{one}{suffix}" for one in stems for suffix in (".png", ".npz", ".npy")):
            if (self._path / name).exists():
                return self._path / name
        times, paths = self._by_time
        if not len(times):
            return None
        nearest = int(np.argmin(np.abs(times - frame.timestamp_s)))
        return paths[nearest] if abs(times[nearest] - frame.timestamp_s) <= _NEAR_S else None

    @cached_property
    def _by_time(self) -> tuple[Floats, list[Path]]:
        """The files whose names are times in seconds with a fraction."""
        timed: dict[float, Path] = {}
        for path in sorted(self._path.iterdir()):
            whole, _, fraction = path.stem.partition(".")
            if path.suffix in (".png", ".npz", ".npy") and whole.isdecimal() and fraction.isdecimal():
                timed[float(path.stem)] = path
        return np.array(list(timed)), list(timed.values())


def read_depth(path: str | os.PathLike[str], root: str | os.PathLike[str], factor: float = 1000.0) -> Floats:
    """Read a depth image.

    Shapes: returns (H, W).

    * ``path``: An image of one channel, whose values are divided by the factor, 0 and 65535 unknown; or an array of
      floats, in a ``.npz`` file as ``depth``.
    * ``root``: The folder of the depths.
    """
    path, what = Path(path), "a depth image"
    check_inside(path, root)
    if path.suffix == ".png":
        data = read_regular(path, _MAX_BYTES, what, SourceError)
        decode_image(str(path), data)  # checks the file
        import cv2

        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None or image.ndim != 2:
            raise SourceError(f"{path}: not a depth image: expected one channel of 8 or 16 bits")
        return np.where((image == 0) | (image == _NONE_16), np.nan, image / factor)
    if path.suffix == ".npy":
        array = read_npy(path, root, what)
    else:
        arrays = read_npz(path, ("depth",), _MAX_BYTES, what)
        if "depth" not in arrays:
            raise SourceError(f"{path}: has no array 'depth'")
        array = arrays["depth"]
    values = np.squeeze(array)
    if values.ndim != 2 or values.dtype.kind not in "iuf" or not values.size:
        raise SourceError(f"{path}: the depth is {array.dtype} of shape {array.shape}: expected numbers (H, W)")
    return values.astype(float)
