"""What a command uses of a source: which frames, and which pixels of them."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import parse_qsl, urlencode

from slam_init.datasets.masks import MaskedSource
from slam_init.datasets.subsampled import SubsampledSource
from slam_init.datasets.timed import TimedSource
from slam_init.errors import SourceError

__all__ = ["SourceView"]

_PREFIX = "view?"


@dataclass(frozen=True)
class SourceView:
    """The frames and pixels of a source that are used; by default all.

    Attributes
    ----------
    every : int
        Every N-th frame, from the start frame on.
    fps : float or None
        The frames nearest to this rate.
    mask : str or None
        A mask for all frames, or a folder of masks.
    """

    every: int = 1
    fps: float | None = None
    mask: str | None = None

    def __post_init__(self) -> None:
        if self.every != 1 and self.fps is not None:
            raise SourceError(f"every {self.every} frames and {self.fps:g} frames a second: give one of both")

    def of(self, source: TimedSource, *, renumbered: bool = False) -> TimedSource:
        """Limit a source to the frames and pixels that are used.

        Parameters
        ----------
        source : TimedSource
        renumbered : bool
            Whether subsampled frames get consecutive indices.

        Returns
        -------
        TimedSource
            The source itself where all is used.

        Raises
        ------
        SourceError
            If an option is impossible, or a mask cannot be read.
        """
        if self.every != 1 or self.fps is not None:
            source = SubsampledSource(source, self.every, self.fps, renumbered)
        return source if self.mask is None else MaskedSource.open(source, self.mask)

    @property
    def query(self) -> str:
        """The options that differ from the defaults, as in ``every=3&mask=car.png``; empty where all is used.

        Returns
        -------
        str
        """
        options = {"every": None if self.every == 1 else self.every, "fps": self.fps, "mask": self.mask}
        return urlencode({name: value for name, value in options.items() if value is not None})

    def text(self, source: str) -> str:
        """Name a source with this view in one text.

        Parameters
        ----------
        source : str
            Argument of :func:`slam_init.open_source`.

        Returns
        -------
        str
            The source itself where all is used; else a text that :meth:`parse` takes apart.
        """
        return f"{_PREFIX}{self.query}:{source}" if self.query else source

    @classmethod
    def parse(cls, text: str) -> tuple[SourceView, str]:
        """Take a text apart that :meth:`text` made.

        Parameters
        ----------
        text : str

        Returns
        -------
        view : SourceView
        source : str
        """
        if not text.startswith(_PREFIX):
            return cls(), text
        query, _, source = text.removeprefix(_PREFIX).partition(":")  # a colon in a value is written as %3A
        options = dict(parse_qsl(query))
        fps = options.get("fps")
        return cls(int(options.get("every", 1)), None if fps is None else float(fps), options.get("mask")), source
