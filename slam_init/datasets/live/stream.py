"""The protocol of a connection that delivers images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from slam_init.types.arrays import Image

__all__ = ["Stream", "StreamImage"]


@dataclass(frozen=True, eq=False)
class StreamImage:
    """An image of a stream.

    Attributes
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey or BGR.
    stream_s : float or None
        Time in seconds that the stream states, from any origin; None if it states none.
    """

    image: Image
    stream_s: float | None


class Stream(Protocol):
    """A connection that delivers images one after the other."""

    def read(self) -> StreamImage | None:
        """Wait for the next image.

        Returns
        -------
        StreamImage or None
            None at the end of the stream, or when the connection is lost.

        Raises
        ------
        SourceError
            If the data are broken.
        """
        ...

    def close(self) -> None:
        """End the connection."""
        ...
