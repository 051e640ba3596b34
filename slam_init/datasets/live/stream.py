"""The protocol of a connection that delivers images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from slam_init.types.arrays import Image


@dataclass(frozen=True, eq=False)
class StreamImage:
    """An image of a stream."""

    #: (H, W) Grey or BGR.
    image: Image
    #: Time in seconds that the stream states, from any origin; None if it states none.
    stream_s: float | None


class Stream(Protocol):
    """A connection that delivers images one after the other."""

    def read(self) -> StreamImage | None:
        """Wait for the next image.

        * Returns: None at the end of the stream, or when the connection is lost.
        """
        ...

    def close(self) -> None:
        """End the connection."""
        ...
