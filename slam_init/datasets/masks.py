"""Masks of a sequence: one image for all frames, or a folder with one for each frame.

As in COLMAP, pixels that are black (0) are ignored, and the mask of ``NAME.EXT`` is ``NAME.EXT.png`` in the folder;
``NAME.png`` is found as well. Frames of a video are named ``frame-000012``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from slam_init.datasets.derived import DerivedSource
from slam_init.datasets.image_files import read_image
from slam_init.datasets.subsampled import SubsampledSource
from slam_init.datasets.timed import TimedSource
from slam_init.errors import SourceError
from slam_init.system.regular_file import user_path
from slam_init.types.arrays import Image
from slam_init.types.frame import Frame, notes_of


@dataclass(frozen=True, eq=False)
class MaskedSource(DerivedSource):
    """A source whose frames have masks.

    * ``source``: Gives the frames.
    """

    #: An image for all frames, or a folder.
    path: Path
    #: (H, W) The mask of all frames; None for a folder.
    of_all: Image | None

    @classmethod
    def open(cls, source: TimedSource, path: str | os.PathLike[str]) -> MaskedSource:
        """Open the masks of a source."""
        path = user_path(path)
        if path.is_dir():
            return cls(source, path, None)
        if not path.exists():
            raise SourceError(f"{path}: no such file or folder of masks")
        return cls(source, path, read_mask(path))

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the source, and what the mask ignores."""
        notes = notes_of(self.source)
        if self.of_all is None:
            return (*notes, f"the masks in {self.path.name} are ignored pixels of the frames")
        return (*notes, f"the mask {self.path.name} ignores {np.mean(self.of_all == 0):.1%} of each image")

    def left(self, start: int) -> int:
        """Count the frames from a frame on."""
        return self.source.left(start) if isinstance(self.source, SubsampledSource) else len(self.source) - start

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Read frames in order, with their masks."""
        for frame in self.source.frames(start, max_frames):
            mask, path = (self.of_all, self.path) if self.of_all is not None else self._of(frame)
            size, expected = mask.shape[::-1], frame.image.shape[1::-1]
            if size != expected:
                raise SourceError(
                    f"{path}: the mask is {size[0]}x{size[1]}, but the frame {frame.name} is "
                    f"{expected[0]}x{expected[1]}: give a mask of the size of the frames"
                )
            yield replace(frame, mask=mask)

    def _of(self, frame: Frame) -> tuple[Image, Path]:
        names = (f"{frame.name}.png", f"{os.path.splitext(frame.name)[0]}.png")  # noqa: PTH122 (a Path drops "./")
        for name in names:
            if (self.path / name).exists():
                return read_mask(self.path / name, self.path), self.path / name
        looked_for = " or ".join(dict.fromkeys(names))
        raise SourceError(
            f"{self.path}: no mask for the frame {frame.name}: add {looked_for}, or give one mask for all"
        )


def read_mask(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None) -> Image:
    """Read a mask.

    Shapes: returns (H, W).

    * ``path``: An image; of a coloured one, pixels that are black in all channels are ignored.
    """
    image = read_image(path, root)
    bright = image if image.ndim == 2 else image.max(axis=2)
    return np.where(bright > 0, np.uint8(255), np.uint8(0))
