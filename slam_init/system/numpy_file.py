"""Arrays of numpy from untrusted files: bounded in size, and nothing is unpickled."""

from __future__ import annotations

from collections.abc import Collection
from typing import BinaryIO

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from slam_init.errors import SourceError


def parse_npz(
    place: str, file: BinaryIO, known: Collection[str], limit_bytes: int, what: str
) -> dict[str, NDArray[np.generic]]:
    """Read named arrays from a ``.npz`` file. No other array is read, and their sizes are looked up before."""
    try:
        with NpzFile(file, allow_pickle=False) as archive:
            assert archive.zip is not None, "it is open"
            sizes = {entry.filename.removesuffix(".npy"): entry.file_size for entry in archive.zip.infolist()}
            names = [name for name in sizes if name in known]
            if sum(sizes[name] for name in names) > limit_bytes:
                raise SourceError(f"{place}: has more than {limit_bytes // 10**6} MB of arrays: this is not {what}")
            arrays = {name: np.asarray(archive[name]) for name in names}
    except SourceError:
        raise
    except Exception as error:  # zipfile, zlib, lzma, bz2 and numpy raise errors of their own for broken data
        raise SourceError(f"{place}: not a readable .npz file of {what} ({str(error)[:80]})") from None
    for name, array in arrays.items():
        if array.dtype.kind not in "biufU":
            raise SourceError(f"{place}: {name} holds {array.dtype}: expected numbers or text")
    return arrays
