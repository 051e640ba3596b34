"""Arrays of numpy from files of strangers: bounded in size, and checked before anything large is allocated."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Collection
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from slam_init.errors import SourceError


def parse_npz(
    place: str, file: BinaryIO, known: Collection[str], limit_bytes: int, what: str
) -> dict[str, NDArray[np.generic]]:
    """Read named arrays from a ``.npz`` file. Nothing is unpickled, and no other array is read."""
    arrays: dict[str, NDArray[np.generic]] = {}
    left = limit_bytes
    try:
        with zipfile.ZipFile(file) as archive:
            for entry in archive.infolist():
                name = entry.filename.removesuffix(".npy")
                if name not in known:
                    continue
                if name in arrays:
                    raise SourceError(f"{place}: holds {name} twice")
                left -= entry.file_size
                if left < 0:
                    raise SourceError(f"{place}: has more than {limit_bytes // 10**6} MB of arrays: this is not {what}")
                with archive.open(entry) as member:  # no more is unpacked than the archive states
                    arrays[name] = parse_npy(f"{place}: {name}", member.read(entry.file_size))
    except SourceError:
        raise
    except Exception as error:  # zipfile, zlib, lzma and bz2 raise errors of their own for broken data
        raise SourceError(f"{place}: not a readable .npz file of {what} ({str(error)[:80]})") from None
    return arrays


def parse_npy(place: str, data: bytes) -> NDArray[np.generic]:
    """The array of a ``.npy`` file, whose header must state the size that the data have."""
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
    except Exception:  # numpy passes on what Python's parser raises
        raise SourceError(f"{place}: not a .npy array, or cut off") from None
    if dtype.hasobject or dtype.kind not in "biufU":
        raise SourceError(f"{place}: holds {dtype}: expected numbers or text")
    if len(data) - stream.tell() < math.prod(shape) * dtype.itemsize:
        raise SourceError(f"{place}: the array is cut off")
    stream.seek(0)
    array: NDArray[np.generic] = np.load(stream, allow_pickle=False)
    return array
