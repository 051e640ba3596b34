"""What a command uses of a source: which frames, and which pixels of them."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import parse_qsl, urlencode

from slam_init.datasets.masks import MaskedSource
from slam_init.datasets.subsampled import SubsampledSource
from slam_init.datasets.timed import TimedSource
from slam_init.errors import SourceError

_PREFIX = "view?"


@dataclass(frozen=True)
class SourceView:
    """The frames and pixels of a source that are used; by default all."""

    #: Every N-th frame, from the start frame on.
    every: int = 1
    #: The frames nearest to this rate.
    fps: float | None = None
    #: A mask for all frames, or a folder of masks.
    mask: str | None = None

    def __post_init__(self) -> None:
        if self.every != 1 and self.fps is not None:
            raise SourceError(f"every {self.every} frames and {self.fps:g} frames a second: give one of both")

    def apply(self, source: TimedSource, *, renumbered: bool = False) -> TimedSource:
        """Limit a source to the frames and pixels that are used."""
        if self.every != 1 or self.fps is not None:
            source = SubsampledSource(source, self.every, self.fps, renumbered)
        return source if self.mask is None else MaskedSource.open(source, self.mask)

    @property
    def query(self) -> str:
        """The options that differ from the defaults, as in ``every=3&mask=car.png``; empty where all is used."""
        options = {"every": None if self.every == 1 else self.every, "fps": self.fps, "mask": self.mask}
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
        fps = options.get("fps")
        return cls(int(options.get("every", 1)), None if fps is None else float(fps), options.get("mask")), source
