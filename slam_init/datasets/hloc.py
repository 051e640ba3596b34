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
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slam_init.datasets.track_source import PairMatches, TrackSource, by_name, chain_matches, track_source
from slam_init.errors import SourceError
from slam_init.system.regular_file import check_inside
from slam_init.types.arrays import Floats, as_array

if TYPE_CHECKING:
    import h5py

#: How a file in HDF5 starts.
HDF5 = b"\x89HDF\r\n\x1a\n"


def open_hloc(path: Path) -> TrackSource:
    """Open the matches of hloc, with the features beside them."""
    features_path = _features_of(path)
    with _opened(features_path) as features:
        names, keypoints, size = _read_features(features_path, features)
    with _opened(path) as matches:
        table, notes = chain_matches(keypoints, _read_matches(path, matches, names), str(path))
    return track_source(path, "hloc", tuple(names), size, table, notes=notes)


def _features_of(matches: Path) -> Path:
    """The file of the features beside that of the matches."""
    others = sorted(path for path in matches.parent.glob("*.h5") if path.name != matches.name)
    named = [path for path in others if matches.stem.startswith(path.stem)]
    found = max(named, key=lambda path: len(path.stem)) if named else (others[0] if len(others) == 1 else None)
    if found is None:
        raise SourceError(f"{matches}: no features beside it: put their .h5 file, and no other, beside it")
    check_inside(found, matches.parent)
    return found


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a file. What the library raises while it is read means that the file is broken."""
    try:
        import h5py
    except ImportError:
        raise SourceError(f'{path}: reading .h5 needs h5py: pip install ".[hloc]"') from None
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, RecursionError) as error:
        raise SourceError(f"{path}: the file is broken ({str(error)[:120]})") from None


def _arrays(group: h5py.Group, end: str) -> dict[str, object]:
    """What lies at paths with this end, by what is before it. Links, which may lead to other files, are left out."""
    names: list[str] = []
    group.visit(names.append)
    return {name.removesuffix(end): group[name] for name in names if name.endswith(end)}


def _numbers(path: Path, name: str, entry: object, shape: tuple[int | None, ...]) -> Floats:
    """The finite numbers of an array; a side of None may have any length."""
    import h5py

    if not isinstance(entry, h5py.Dataset) or entry.is_virtual or entry.external:
        raise SourceError(f"{path}: {name[:200]}: is no array in this file")
    return as_array(entry[()], np.float64, shape, f"{path}: {name[:200]}", error=SourceError)


def _read_features(path: Path, features: h5py.File) -> tuple[list[str], list[Floats], tuple[int, int]]:
    """Names of the images in their order, their keypoints, and the size of all images."""
    points, sizes = _arrays(features, "/keypoints"), _arrays(features, "/image_size")
    if not points:
        raise SourceError(f"{path}: holds no keypoints: name the matches, with the features beside them")
    listed = list(points)
    names = [listed[i] for i in by_name(path, listed)]
    keypoints = [_numbers(path, f"{name}/keypoints", points[name], (None, None))[:, :2] for name in names]
    stated = [_numbers(path, f"{name}/image_size", sizes.get(name), (2,)).tolist() for name in names]
    if other := next((name for name, size in zip(names, stated, strict=True) if size != stated[0]), None):
        raise SourceError(f"{path}: {other} and {names[0]} have different sizes: all images must be of one camera")
    width, height = stated[0]
    return names, keypoints, (int(width), int(height))


def _read_matches(path: Path, matches: h5py.File, names: list[str]) -> Iterator[PairMatches]:
    index = {name.replace("/", "-"): i for i, name in enumerate(names)}
    if len(index) < len(names):
        raise SourceError(f"{path}: two images differ in / and - only, which hloc does not distinguish")
    partners = _arrays(matches, "/matches0")
    if not partners:
        raise SourceError(f"{path}: holds no matches0: name the file of the matches, not that of the features")
    for name, entry in partners.items():
        pair = _pair(name, index)
        if pair is None:
            raise SourceError(f"{path}: {name[:200]}: names an image that the features do not have")
        partner = _numbers(path, f"{name}/matches0", entry, (None,)).astype(np.int64)
        first = np.flatnonzero(partner > -1)
        yield PairMatches(*pair, np.column_stack([first, partner[first]]))


def _pair(name: str, index: dict[str, int]) -> tuple[int, int] | None:
    """The images of ``NAME0/NAME1``, or of ``NAME0_NAME1`` of older versions."""
    ends = (at for separator in "/_" for at, character in enumerate(name) if character == separator)
    parts = ((name[:at], name[at + 1 :]) for at in ends)
    return next(((index[a], index[b]) for a, b in parts if a in index and b in index), None)
