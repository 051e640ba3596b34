"""Tracks without images as a source: ``points:NAME``, or with options ``points:NAME?noise_px=1&baseline=0.05``.

A hand-held rolling-shutter camera that only turns is
``points:handheld?turning_deg_s=60&readout_ms=30&fps=30&views=60``. An option that is on or off is 1 or 0, as in
``stabilized=1``. The names are those of :data:`sequences_synth.POINT_SCENES`, the options those of
:class:`sequences_synth.PointOptions`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slam_init.datasets.image_files import frame_range
from slam_init.datasets.synth import SimulatedSource, option_values
from slam_init.datasets.track_source import draw_points
from slam_init.errors import SourceError
from slam_init.types.frame import Frame, Observations

if TYPE_CHECKING:
    from sequences_synth import PointSequence

POINTS = "points:"

# Grey value of a point.
_DOT = 220


@dataclass(frozen=True, eq=False)
class PointSource(SimulatedSource):
    """A :class:`slam_init.types.frame.Source` with given tracks; its images are dots on a dark background."""

    sequence: PointSequence
    kind = "points"

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Draw images of the tracks."""
        camera = self.sequence.camera
        for index in frame_range(len(self), start, max_frames, self.name):
            _, pixels = self.sequence.observe(index)
            image = draw_points((camera.width, camera.height), pixels)
            yield Frame(index, float(self.timestamps_s[index]), f"frame-{index:06d}", image)

    def observations(self, start: int = 0) -> Iterator[Observations]:
        """Give the tracks of each frame in order."""
        camera = self.camera
        for index in range(start, len(self)):
            track_ids, pixels = self.sequence.observe(index)
            yield Observations(
                frame=index,
                timestamp_s=float(self.timestamps_s[index]),
                name=f"frame-{index:06d}",
                track_ids=track_ids,
                pixels=pixels,
                bearings=camera.bearings(pixels),
                colors=np.full((len(track_ids), 3), _DOT, np.uint8),
            )


def open_points(text: str, seed: int) -> PointSource:
    """Open ``points:NAME[?option=value&...]``.

    * ``text``: Name of the source; the options are those of :class:`sequences_synth.PointOptions`.
    """
    from sequences_synth import PointOptions, make_points

    name, _, query = text.removeprefix(POINTS).partition("?")
    values = option_values(text, query, PointOptions())
    try:
        return PointSource(make_points(name, seed, PointOptions(**values)))
    except ValueError as error:
        raise SourceError(str(error)) from None
