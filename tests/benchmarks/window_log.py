"""The log of :mod:`tests.benchmarks.window_fit`: one window a line, as JSON.

A figure that is not finite is written as null, and read as NaN. Lines of several files may be concatenated.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from slam_init.errors import SlamInitError
from slam_init.output.plain_json import plain
from slam_init.types.comparison import Margin
from slam_init.window.risk import WindowRisk
from slam_init.window.uncertainty import CameraEstimate, DistortionEstimate, FocalEstimate, ReadoutEstimate

#: What counts as wrong, in degrees.
ROTATION_DEG, DIRECTION_DEG = 5.0, 15.0
#: As many significant digits tell a float exactly.
_DIGITS = 17


@dataclass(frozen=True)
class Accuracy:
    """True errors of the best hypothesis of a window, and their squares in units of the stated covariance.

    A normalized squared error (NEES) is ``e^T C^-1 e``. It has a chi-square distribution with as many degrees of
    freedom as the error has unknowns, if the covariance C is right. All figures are NaN or 0 without a hypothesis.
    """

    #: Largest error of a rotation over the views.
    rotation_deg: float = math.nan
    #: Error of the direction of the pair's baseline; 180 if the camera did not translate.
    direction_deg: float = math.nan
    #: Of the pair's rotation: 3 unknowns.
    rotation_nees: float = math.nan
    #: Of the direction of the pair's baseline by the expansion of the cost: 2 unknowns.
    direction_nees: float = math.nan
    #: The same, with the covariance enlarged so that its largest standard deviation is that of the risk, which knows
    #: the scatter of the scores as well.
    scattered_direction_nees: float = math.nan
    #: Tracks that the reference sees and whose distance is judged: points of a drawn world at rest.
    depth_tracks: int = 0
    #: Those whose inverse distance is within 1.96 standard deviations of the true one.
    depth_covered: int = 0
    #: Mean over these tracks of the squared error of the inverse distance in units of its variance.
    depth_nees: float = math.nan
    #: Median over these tracks; 0.455 for Gaussian errors.
    depth_median_nees: float = math.nan


@dataclass(frozen=True)
class Window:
    """One window, as it would have been judged."""

    #: Name of the scene, or path of the sequence below the folder of the data.
    scene: str
    #: Over the median depth; 0 for real sequences.
    baseline: float
    #: Name of the trial: the seed of a world, or the first frame.
    start: str
    #: Number of views of the window.
    views: int
    #: Kind of the best motion; that of the pair's pose where no motion was proposed; ``none`` without a pose.
    kind: str
    #: None where no motion was proposed.
    risk: WindowRisk | None
    accuracy: Accuracy = field(default_factory=Accuracy)
    #: Of all fits and the risk, without the pair's pose.
    milliseconds: float = 0.0

    @property
    def wrong(self) -> bool:
        """Whether a map of the best hypothesis would be wrong."""
        return not (self.accuracy.rotation_deg <= ROTATION_DEG and self.accuracy.direction_deg <= DIRECTION_DEG)


def write_log(path: str | os.PathLike[str], windows: Iterable[Window]) -> Iterator[Window]:
    """Pass windows on; each one is written as a line before it is passed on."""
    with Path(path).open("w", encoding="utf-8") as file:
        for window in windows:
            file.write(json.dumps(plain(window, _DIGITS)) + "\n")
            file.flush()
            yield window


def read_log(path: str | os.PathLike[str]) -> Iterator[Window]:
    """Read windows."""
    with Path(path).open(encoding="utf-8") as file:
        for number, line in enumerate(file, 1):
            try:
                yield _window(json.loads(line))
            except (KeyError, TypeError, ValueError) as error:
                raise SlamInitError(f"{os.fspath(path)}, line {number} is no window: {error!r}") from None


def _window(record: Mapping[str, Any]) -> Window:
    risk, accuracy = record["risk"], _numbers(record["accuracy"])
    if risk is not None:
        margin = risk["margin"]
        of_views = tuple(math.nan if one is None else float(one) for one in risk["direction_of_views"])
        no_numbers = ("margin", "direction_of_views", "camera", "moving_tracks")
        others = _numbers({key: value for key, value in risk.items() if key not in no_numbers})
        margin = None if margin is None else Margin(**_numbers(margin))
        risk = WindowRisk(
            **others,
            margin=margin,
            direction_of_views=of_views,
            camera=_camera(risk["camera"]),
            moving_tracks=tuple(risk["moving_tracks"]),
        )
    known = {name: record[name] for name in (one.name for one in fields(Window)) if name not in ("risk", "accuracy")}
    return Window(**known, risk=risk, accuracy=Accuracy(**accuracy))


def _camera(record: Mapping[str, Any]) -> CameraEstimate:
    readout = None if record["readout"] is None else ReadoutEstimate(**record["readout"])
    return CameraEstimate(FocalEstimate(**record["focal"]), DistortionEstimate(**record["distortion"]), readout)


def _numbers(record: Mapping[str, Any]) -> dict[str, Any]:
    return {key: math.nan if value is None else value for key, value in record.items()}
