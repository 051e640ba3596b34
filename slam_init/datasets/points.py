"""Tracks without images as a source: ``points:NAME``, or with options ``points:NAME?noise_px=1&baseline=0.05``.

A hand-held rolling-shutter camera that only turns is
``points:handheld?turning_deg_s=60&readout_ms=30&fps=30&views=60``. An option that is on or off is 1 or 0, as in
``stabilized=1``. The names are those of :data:`sequences_synth.POINT_SCENES`, the options those of
:class:`sequences_synth.PointOptions`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from slam_init.datasets.match_chains import TrackTable
from slam_init.datasets.synth import option_values, stated_by
from slam_init.datasets.track_source import TrackSource
from slam_init.errors import SourceError

if TYPE_CHECKING:
    from sequences_synth import PointSequence
    from slam_init.types.camera import Camera
    from slam_init.types.pose import Trajectory


POINTS = "points:"


@dataclass(frozen=True, eq=False, kw_only=True)
class PointSource(TrackSource):
    """The tracks of a simulated sequence, which also knows what is true of them."""

    camera: Camera
    groundtruth: Trajectory
    sequence: PointSequence

    @classmethod
    def of(cls, sequence: PointSequence) -> PointSource:
        """Make the source of a sequence."""
        name, camera, truth, times_s = stated_by(sequence)
        frames, ids = np.nonzero(sequence.visible)
        table, size = TrackTable(frames, ids, sequence.pixels[frames, ids]), (camera.width, camera.height)
        names = tuple(f"frame-{index:06d}" for index in range(len(sequence)))
        return cls(name, "points", names, times_s, size, table, camera=camera, groundtruth=truth, sequence=sequence)


def open_points(text: str, seed: int) -> PointSource:
    """Open ``points:NAME[?option=value&...]``.

    * ``text``: Name of the source; the options are those of :class:`sequences_synth.PointOptions`.
    """
    from sequences_synth import PointOptions, make_points

    name, _, query = text.removeprefix(POINTS).partition("?")
    values = option_values(text, query, PointOptions())
    try:
        return PointSource.of(make_points(name, seed, PointOptions(**values)))
    except ValueError as error:
        raise SourceError(str(error)) from None
