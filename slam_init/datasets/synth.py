"""Synthetic sequences as a source: ``synth:NAME``, or with options ``synth:NAME?frames=50&noise=4``.

Tracks without images are ``points:NAME``, or ``points:NAME?noise_px=1&baseline=0.05``. A hand-held rolling-shutter
camera that only turns is ``points:handheld?turning_deg_s=60&readout_ms=30&fps=30&views=60``. A switch is 1 or 0. The
names are those of :data:`sequences_synth.POINT_SCENES`, the options those of
:class:`sequences_synth.PointOptions`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl

import numpy as np

from slam_init.datasets.image_files import frame_range
from slam_init.datasets.inertial import InertialSensor, of_sensor
from slam_init.datasets.text import pose_from_matrix
from slam_init.datasets.track_source import TrackSource, TrackTable
from slam_init.errors import SourceError
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.pose import Trajectory

if TYPE_CHECKING:
    from sequences_synth import PointSequence, SynthOptions, SynthSequence


PREFIX = "synth:"
# Values of options that are on or off.
_SWITCH = {"0": False, "1": True}


def stated_by(sequence: SynthSequence | PointSequence) -> tuple[str, Camera, Trajectory, Floats]:
    """What a rendered sequence and one of tracks alone state: name, camera, exact trajectory and times.

    The stated camera is wrong by the options ``focal_error``, ``principal_error`` and ``k1``.
    """
    c = sequence.camera
    camera = Camera(c.model, c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.coefficients)
    poses = tuple(pose_from_matrix(sequence.name, matrix) for matrix in sequence.poses)
    return sequence.name, camera, Trajectory(sequence.timestamps_s, poses), sequence.timestamps_s


@dataclass(frozen=True, eq=False)
class SynthSource:
    """A :class:`slam_init.types.frame.Source` that renders a frame when it is requested."""

    sequence: SynthSequence
    #: name, camera, groundtruth, timestamps_s: See :func:`stated_by`.
    name: str
    camera: Camera
    groundtruth: Trajectory
    timestamps_s: Floats
    kind = "synth"
    gyroscope, inertial = of_sensor("gyroscope"), of_sensor("record")

    @cached_property
    def _sensor(self) -> InertialSensor | None:
        measured = self.sequence.inertial()
        if measured is None:
            return None
        samples = np.concatenate([measured.rates_rad_s, measured.accelerations_m_s2], axis=1)
        names = ("gyroscope_density", "accelerometer_density")
        densities = {name: getattr(measured.noise, name) for name in names}
        pose = pose_from_matrix(self.name, measured.cam_from_imu)
        return InertialSensor.made(measured.timestamps_s, samples, pose, densities, name="the simulated sensor")

    def __len__(self) -> int:
        return len(self.sequence)

    def frames(self, start: int = 0, max_frames: int | None = None) -> Iterator[Frame]:
        """Render frames in order, each when it is requested."""
        for index in frame_range(len(self), start, max_frames, self.name):
            image, _ = self.sequence.render(index)
            yield Frame(index, float(self.timestamps_s[index]), f"frame-{index:06d}", image)


def open_synth(text: str, seed: int) -> SynthSource:
    """Open ``synth:NAME[?option=value&...]``.

    * ``text``: Name of the source; the options are those of :class:`sequences_synth.SynthOptions`.
    """
    from sequences_synth import SynthOptions

    name, _, query = text.removeprefix(PREFIX).partition("?")
    sequence = make_synth(name, seed, option_values(text, query, SynthOptions()))
    return SynthSource(sequence, *stated_by(sequence))


def option_values(text: str, query: str, defaults: Any) -> dict[str, Any]:
    """Parse the options ``name=value&...`` of a source.

    * ``defaults``: Its fields are the known options; the type of each default is that of the value.
    """
    known = {field.name: type(getattr(defaults, field.name)) for field in fields(defaults)}
    values: dict[str, Any] = {}
    for key, value in parse_qsl(query, keep_blank_values=True):
        if key not in known:
            raise SourceError(f"{text}: unknown option {key!r}: use one of {', '.join(known)}")
        is_switch = known[key] is bool
        try:
            values[key] = _SWITCH[value] if is_switch else known[key](value)
        except (KeyError, ValueError):
            raise SourceError(f"{text}: {key} is {value!r}: give {'0 or 1' if is_switch else 'a number'}") from None
    return values


def make_synth(name: str, seed: int, values: dict[str, Any]) -> SynthSequence:
    """Make a synthetic sequence.

    * ``values``: Options of :class:`sequences_synth.SynthOptions`; the others keep their defaults.
    """
    import sequences_synth

    try:
        options: SynthOptions = sequences_synth.SynthOptions(**values)
        return sequences_synth.make_sequence(name, seed, options)
    except ValueError as error:
        raise SourceError(str(error)) from None


# -- tracks without images -------------------------------------------------------------------------


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
