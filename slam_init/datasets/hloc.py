"""Features and matches of hloc (``.h5``) as a source of tracks.

The file of the matches is named; that of the features lies beside it. hloc makes the name of the matches from that of
the features (``feats-superpoint.h5``, ``feats-superpoint_matches-lightglue_pairs.h5``): the longest name that the name
of the matches starts with is taken, or the only other ``.h5`` file.

The features hold ``NAME/keypoints`` (N, 2 or more) and ``NAME/image_size``, the matches ``NAME0/NAME1/matches0`` (N,),
where ``/`` in a name is ``-``; an entry is the index of the keypoint of the second image, or -1. Pixel centres are at
integer coordinates. These files hold no camera.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slam_init.datasets.match_chains import PairMatches, chain_matches
from slam_init.datasets.track_source import TrackSource, by_name, track_source
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside, open_regular
from slam_init.types.arrays import Floats, Ints

if TYPE_CHECKING:
    import h5py

_MAGIC = b"\x89HDF\r\n\x1a\n"
_MAX_ARRAY_BYTES = 100_000_000
_MAX_TOTAL_BYTES = 4_000_000_000
# Groups of a file: a thousand images with a hundred neighbours each.
_MAX_PAIRS = 1_000_000


def is_hdf5(path: Path) -> bool:
    """Tell whether a file is in HDF5, by its content or its suffix."""
    return path.suffix.lower() in (".h5", ".hdf5") or _has_magic(path)


def _has_magic(path: Path) -> bool:
    with open_regular(path, SourceError) as file:
        return file.read(len(_MAGIC)) == _MAGIC


def open_hloc(path: Path) -> TrackSource:
    """Open the matches of hloc, with the features beside them."""
    try:
        import h5py  # noqa: F401 (the readers below use it)
    except ImportError:
        raise SourceError(f'{path}: reading .h5 needs h5py: pip install ".[hloc]"') from None
    features = _Hdf5(_features_of(path))
    with features:
        names, keypoints, size = _read_features(features)
    matches = _Hdf5(path)
    with matches:
        table, dropped = chain_matches(keypoints, _read_matches(matches, names), str(path))
    notes = (f"{dropped} matches would join two points of one image in a track, and are dropped",) if dropped else ()
    return track_source(path, "hloc", tuple(names), size, table, notes=notes)


def _features_of(matches: Path) -> Path:
    """The file of the features beside that of the matches."""
    others = sorted(path for path in matches.parent.glob("*.h5") if path.name != matches.name)
    named = [path for path in others if matches.stem.startswith(path.stem)]
    found = max(named, key=lambda path: len(path.stem)) if named else (others[0] if len(others) == 1 else None)
    if found is None:
        raise SourceError(
            f"{matches}: no features beside it: put the .h5 file of the features, and no other, beside it"
        )
    check_inside(found, matches.parent)
    return found


class _Hdf5:
    """An open file, of which only arrays that lie in it are read, up to a total size."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._left = _MAX_TOTAL_BYTES

    def __enter__(self) -> _Hdf5:
        import h5py

        if not _has_magic(self.path):
            raise SourceError(f"{self.path}: is no HDF5 file of hloc")
        try:
            self.file = h5py.File(self.path, "r")
        except (OSError, RuntimeError, ValueError) as error:
            raise SourceError(f"{self.path}: cannot be read ({str(error)[:120]})") from None
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def broken(self, name: str, what: str) -> SourceError:
        return SourceError(f"{self.path}: {name[:200]}: {what}")

    def children(self, group: h5py.Group, depth: int) -> Iterator[tuple[str, h5py.Group | h5py.Dataset]]:
        """The entries of a group and of the groups in it, without links to other files."""
        import h5py

        for key in group:
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                raise self.broken(key, "is a link: copy the file without links")
            entry = group[key]
            yield entry.name.strip("/"), entry
            if isinstance(entry, h5py.Group) and depth > 1:
                yield from self.children(entry, depth - 1)

    def array(self, name: str, entry: object, dimensions: int) -> Floats:
        """The numbers of an array."""
        import h5py

        if not isinstance(entry, h5py.Dataset) or entry.is_virtual or entry.external:
            raise self.broken(name, "is no array in this file")
        if entry.dtype.kind not in "iuf" or entry.ndim != dimensions:
            raise self.broken(name, f"is {entry.dtype} of shape {entry.shape}: expected numbers")
        size_bytes = entry.size * max(entry.dtype.itemsize, 8)
        self._left -= size_bytes
        if size_bytes > _MAX_ARRAY_BYTES or self._left < 0:
            raise self.broken(name, f"has {entry.size} numbers: this is not hloc's")
        return np.asarray(entry[()], float)


def _read_features(features: _Hdf5) -> tuple[list[str], list[Floats], tuple[int, int]]:
    """Names of the images in their order, their keypoints, and the size of all images."""
    import h5py

    points: dict[str, Floats] = {}
    sizes: dict[str, tuple[int, int]] = {}
    try:
        for name, entry in features.children(features.file, 8):
            if isinstance(entry, h5py.Dataset) and name.endswith("/keypoints"):
                image = name.removesuffix("/keypoints")
                found = features.array(name, entry, 2)
                if found.shape[1] < 2 or not np.isfinite(found).all():
                    raise features.broken(name, "is no array of finite positions (N, 2)")
                points[image] = found[:, :2]
                size = features.array(f"{image}/image_size", entry.parent.get("image_size"), 1)
                if len(size) != 2 or not np.isfinite(size).all():
                    raise features.broken(f"{image}/image_size", "is no width and height")
                sizes[image] = int(size[0]), int(size[1])
    except (OSError, RuntimeError, KeyError, ValueError, RecursionError) as error:
        raise SourceError(f"{features.path}: the file is broken ({str(error)[:120]})") from None
    if not points:
        raise SourceError(f"{features.path}: holds no keypoints: name the matches, with the features beside them")
    names = list(points)
    names = [names[i] for i in by_name(features.path, names)]
    first = sizes[names[0]]
    other = next((name for name in names if sizes[name] != first), None)
    if other is not None:
        width, height = sizes[other]
        raise SourceError(
            f"{features.path}: {other} has {width}x{height} pixels, but {names[0]} has {first[0]}x{first[1]}: "
            "all images must be of one camera"
        )
    return names, [points[name] for name in names], first


def _read_matches(matches: _Hdf5, names: list[str]) -> Iterator[PairMatches]:
    index = {name.replace("/", "-"): i for i, name in enumerate(names)}
    if len(index) < len(names):
        raise SourceError(f"{matches.path}: two images differ in / and - only, which hloc does not tell apart")
    found = 0
    try:
        for name, entry in matches.children(matches.file, 3):
            if not name.endswith("/matches0"):
                continue
            found += 1
            if found > _MAX_PAIRS:
                raise SourceError(f"{matches.path}: more than {_MAX_PAIRS} pairs: give fewer")
            pair = _pair(name.removesuffix("/matches0"), index)
            if pair is None:
                raise matches.broken(name, "names an image that the features do not have")
            yield PairMatches(*pair, _keypoint_pairs(matches, name, matches.array(name, entry, 1)))
    except (OSError, RuntimeError, KeyError, ValueError, RecursionError) as error:
        raise SourceError(f"{matches.path}: the file is broken ({str(error)[:120]})") from None
    if not found:
        raise SourceError(f"{matches.path}: holds no matches0: name the file of the matches, not that of the features")


def _keypoint_pairs(matches: _Hdf5, name: str, partner: Floats) -> Ints:
    """The keypoints of both images; -1 stands for no match."""
    if not np.isfinite(partner).all() or (np.abs(partner) > 2**53).any():
        raise matches.broken(name, "holds something else than indices of keypoints")
    first = np.flatnonzero(partner > -1)
    return np.column_stack([first, partner[first].astype(np.int64)])


def _pair(name: str, index: dict[str, int]) -> tuple[int, int] | None:
    """The images of ``NAME0/NAME1``, or of ``NAME0_NAME1`` of older versions."""
    for separator in "/_":
        at = name.find(separator)
        while at >= 0:
            first, second = name[:at], name[at + 1 :]
            if first in index and second in index:
                return index[first], index[second]
            at = name.find(separator, at + 1)
    return None
