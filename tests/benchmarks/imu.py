"""Scale and gravity by an inertial sensor: ``python -m tests.benchmarks.imu``.

A camera moves as a hand, a drone or a car does, and sees up to 400 points. Their tracks have a noise of 0.5 px, in each
view a smooth error of 0.1 px that they share, as good trackers and lenses leave, and 5 % of outliers. A sensor of a
phone measures beside it (:mod:`sequences_synth.inertial`), with a clock that is off by a millisecond. An initializer
gets 4 to 20 frames at 5 to 20 Hz, and its map grows until the last one. The scale is that of
:func:`slam_init.find_scale`; a wrong record takes the place of the right one.

With ``--gravity`` no record is simulated: drawn worlds of tracks get the gravity of each frame, right (an offset of 0.5
degrees, and a noise of 0.3 degrees) or wrong, stated to 0.7 degrees.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from sequences_synth.inertial import measure
from sequences_synth.tracking_error import TrackingError
from slam_init.compare.judging import Criteria
from slam_init.compare.measures import is_correct, pose_errors
from slam_init.compare.sources import open_compared
from slam_init.config import Config
from slam_init.datasets.points import PointSource
from slam_init.initializer import Initializer
from slam_init.scale.find import find_scale
from slam_init.scale.requests import MeasuredMotion
from slam_init.types.arrays import Floats
from slam_init.types.camera import Camera
from slam_init.types.frame import Observations
from slam_init.types.inertial import Gravity, InertialRecord
from slam_init.types.initial_map import InitialMap
from slam_init.types.pose import Pose
from slam_init.types.scale import Scale
from tests.benchmarks.options import positive

CAMERA = Camera("pinhole", 640, 480, 525.0, 525.0, 319.5, 239.5)
_NOISE_PX, _FIELD_PX, _OUTLIERS, _CLOCK_S, _LATE_S = 0.5, 0.1, 0.05, 0.001, 0.05
#: Frames of a clip, and the groups of the table.
_FRAMES, _GROUPS = (4, 20), ((4, 7), (8, 13), (14, 20))
#: x right, y down, z forward, along the y axis of a world whose z axis points up.
_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])

#: Seconds -> position (3,) in the world and rotation vector (3,) of the camera.
Motion = Callable[[float], tuple[Floats, Floats]]


class Kind(NamedTuple):
    """A kind of motion."""

    draw: Callable[[np.random.Generator], Motion]
    #: Nearest and farthest points, metres.
    depths_m: tuple[float, float]
    rates_hz: tuple[float, float]


def _sines(rng: np.random.Generator, hertz: Sequence[float], sizes: Sequence[float]) -> Callable[[float], Floats]:
    """A sum of sines for each of three axes, with frequencies and sizes drawn around those given."""
    rates = 2 * np.pi * np.array(hertz) * rng.uniform(0.8, 1.25, (3, len(hertz)))
    amplitudes, phases = np.array(sizes) * rng.uniform(0.5, 1.5, rates.shape), rng.uniform(0, 2 * np.pi, rates.shape)
    return lambda t: np.sum(amplitudes * np.sin(rates * t + phases), axis=1)


def _walk(rng: np.random.Generator) -> Motion:
    """A person who walks sideways or on, with two steps a second, and holds the camera."""
    speed, heading = rng.uniform(0.5, 1.3), rng.uniform(-np.pi, np.pi)
    velocity = speed * np.array([np.cos(heading), np.sin(heading), 0.0])
    steps, turning = _sines(rng, (0.95, 1.9), (0.02, 0.02)), _sines(rng, (0.5, 1.9), (0.05, 0.01))
    return lambda t: (velocity * t + steps(t), turning(t))


def _sway(rng: np.random.Generator) -> Motion:
    """A person who stands, and moves the camera to and fro by a hand's breadth."""
    sway, turning = _sines(rng, (0.7, 1.5), (0.08, 0.02)), _sines(rng, (0.6, 1.5), (0.08, 0.02))
    return lambda t: (sway(t), turning(t))


def _drone(rng: np.random.Generator) -> Motion:
    """A drone that speeds up and brakes by some m/s^2 and tilts by it."""
    hertz, size = 0.5 * rng.uniform(0.8, 1.25), rng.uniform(0.2, 0.5)
    turns, across = rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi, np.pi)
    along = np.array([np.cos(across), np.sin(across), rng.uniform(-0.3, 0.3)])
    cruise, shake = rng.uniform(0.5, 2.0), _sines(rng, (1.2, 4.0), (0.02, 0.001))
    turning = _sines(rng, (0.4, 1.5), (0.05, 0.01))

    def motion(t: float) -> tuple[Floats, Floats]:
        phase = 2 * np.pi * hertz * t + turns
        lean = (2 * np.pi * hertz) ** 2 * size * np.sin(phase) / 9.8
        tilt = lean * np.array([-along[1], 0.0, along[0]])
        return (cruise * t + size * np.sin(phase)) * along + shake(t), turning(t) + tilt

    return motion


def _car(rng: np.random.Generator) -> Motion:
    """A car that drives straight on at a constant speed."""
    speed = rng.uniform(5.0, 15.0)
    return lambda t: (np.array([0.0, speed * t, 0.0]), np.zeros(3))


def _rotation(rng: np.random.Generator) -> Motion:
    """A camera on a tripod that only turns."""
    turning = _sines(rng, (0.3, 0.9), (0.15, 0.05))
    return lambda t: (np.zeros(3), turning(t))


KINDS: dict[str, Kind] = {
    "hand, walking": Kind(_walk, (1.5, 6.0), (5.0, 20.0)),
    "hand, to and fro": Kind(_sway, (1.0, 4.0), (5.0, 20.0)),
    "drone": Kind(_drone, (3.0, 15.0), (5.0, 20.0)),
    "car, constant speed": Kind(_car, (4.0, 40.0), (5.0, 20.0)),
    "rotation": Kind(_rotation, (1.5, 6.0), (5.0, 20.0)),
}


class Clip(NamedTuple):
    """A motion, its frames and its record."""

    path: Callable[[float], Floats]
    times_s: Floats
    frames: tuple[Observations, ...]
    record: InertialRecord

    @staticmethod
    def drawn(kind: Kind, seed: int) -> Clip:
        """Draw a clip."""
        rng = np.random.default_rng((seed, 7))
        motion, count = kind.draw(rng), int(rng.integers(_FRAMES[0], _FRAMES[1] + 1))
        level = _LEVEL @ rotation_from_vector(np.array([rng.uniform(-0.4, 0.4), 0.0, rng.uniform(-0.1, 0.1)]))

        def path(time_s: float) -> Floats:
            pose = np.eye(4)
            pose[:3, 3], turn = motion(time_s)
            pose[:3, :3] = level @ rotation_from_vector(turn)
            return pose

        times_s = np.arange(count) / rng.uniform(*kind.rates_hz)
        samples = measure(path, np.arange(-0.2, float(times_s[-1]) + 0.2, 0.005), rng)
        pose = Pose(samples.cam_from_imu[:3, :3], samples.cam_from_imu[:3, 3])
        late_s, noise = _CLOCK_S * rng.normal(), samples.noise
        record = InertialRecord(
            samples.timestamps_s + late_s, samples.rates_rad_s, samples.accelerations_m_s2, pose,
            noise.gyroscope_density, noise.accelerometer_density, _CLOCK_S,
        )  # fmt: skip
        return Clip(path, times_s, tuple(_seen(path, times_s, kind, rng)), record)

    def map(self) -> InitialMap | None:
        """The map of the frames."""
        initializer = Initializer(CAMERA, replace(Config(), refine_frames=len(self.frames)))
        for observed in self.frames:
            initializer.process_tracks(observed)
        return initializer.finish().map


def _seen(
    path: Callable[[float], Floats], times_s: Floats, kind: Kind, rng: np.random.Generator
) -> Iterator[Observations]:
    """The tracks of the frames. Points are drawn in the views, uniformly in pixels and in inverse depth."""
    points = []
    for time_s in np.linspace(times_s[0], times_s[-1], 5):
        pixels = rng.uniform((0, 0), (CAMERA.width - 1, CAMERA.height - 1), (120, 2))
        near, far = kind.depths_m
        rays = CAMERA.bearings(pixels)
        depths = 1 / rng.uniform(1 / far, 1 / near, 120)
        pose = path(float(time_s))
        points.append(rays / rays[:, 2:] * depths[:, None] @ pose[:3, :3].T + pose[:3, 3])
    world = np.concatenate(points)
    shared = TrackingError.draw(rng, len(times_s), CAMERA.width, CAMERA.height, _FIELD_PX, 0.0)
    for frame, time_s in enumerate(times_s.tolist()):
        pose = path(time_s)
        pixels = CAMERA.project((world - pose[:3, 3]) @ pose[:3, :3])
        pixels += shared.at(frame, pixels) + _NOISE_PX * rng.normal(size=pixels.shape)
        wrong = rng.random(len(world)) < _OUTLIERS
        pixels[wrong] = rng.uniform((0, 0), (CAMERA.width - 1, CAMERA.height - 1), (int(wrong.sum()), 2))
        with np.errstate(invalid="ignore"):
            ids = np.flatnonzero(((pixels >= 0) & (pixels <= (CAMERA.width - 1, CAMERA.height - 1))).all(axis=1))
        ids = ids[:400]
        yield Observations(frame, time_s, f"{frame}", ids, pixels[ids], CAMERA.bearings(pixels[ids]))


class Row(NamedTuple):
    """What came of a clip."""

    frames: int
    keyframes: int
    #: Of the right record and of each wrong one; None without a map.
    scales: dict[str, Scale]
    #: Logarithm of the scale over the true one, by the record.
    errors: dict[str, float]
    gravity_deg: float


def wrong_records(kind: Kind, clip: Clip, seed: int) -> dict[str, InertialRecord]:
    """Records that are not of the camera."""
    right, swapped = clip.record, [1, 0, 2]
    other = Clip.drawn(kind, seed + 500_000).record
    times_s = right.timestamps_s
    kept = np.searchsorted(other.timestamps_s, times_s).clip(0, len(other.timestamps_s) - 1)
    return {
        "late by 50 ms": replace(right, timestamps_s=times_s + _LATE_S),
        "early by 50 ms": replace(right, timestamps_s=times_s - _LATE_S),
        "swapped axes": replace(
            right, rates_rad_s=right.rates_rad_s[:, swapped], accelerations_m_s2=right.accelerations_m_s2[:, swapped]
        ),
        "another record": replace(
            right, rates_rad_s=other.rates_rad_s[kept], accelerations_m_s2=other.accelerations_m_s2[kept]
        ),
    }


def run_clip(kind: Kind, seed: int) -> Row:
    """Find the scale of a clip by the right record and by the wrong ones."""
    clip = Clip.drawn(kind, seed)
    map_ = clip.map()
    if map_ is None:
        return Row(len(clip.frames), 0, {}, {}, np.nan)
    records = {"right": clip.record, **wrong_records(kind, clip, seed)}
    scales = {name: find_scale(map_, MeasuredMotion(), imu=record) for name, record in records.items()}
    first = map_.keyframes[0]
    far = max(map_.keyframes, key=lambda one: float(np.linalg.norm(one.world_from_cam.t - first.world_from_cam.t)))
    units = np.linalg.norm(far.world_from_cam.t - first.world_from_cam.t)
    true_m = np.linalg.norm(clip.path(far.timestamp_s)[:3, 3] - clip.path(first.timestamp_s)[:3, 3])
    errors = {
        name: float(np.log(scale.metres_per_unit * units / true_m))
        for name, scale in scales.items()
        if scale.metres_per_unit is not None
    }
    gravity = scales["right"].gravity
    down = first.world_from_cam.R @ clip.path(first.timestamp_s)[:3, :3].T @ [0.0, 0.0, -1.0]
    off = np.nan if gravity is None else float(np.degrees(np.arccos(np.clip(gravity.down @ down, -1, 1))))
    return Row(len(clip.frames), len(map_.keyframes), scales, errors, off)


def _within(row: Row) -> bool:
    sigma = row.scales["right"].sigma
    return sigma is not None and abs(row.errors["right"]) <= 1.96 * sigma


def _cells(rows: Sequence[Row]) -> list[str]:
    maps = [row for row in rows if row.scales]
    found = [row for row in maps if "right" in row.errors]
    if not found:
        return [str(len(rows)), str(len(maps)), "0", "-", "-", "-", "-"]
    errors = np.abs([row.errors["right"] for row in found])
    sigmas = [row.scales["right"].sigma for row in found]
    gravity = np.array([row.gravity_deg for row in found])
    within = np.mean([_within(row) for row in found])
    return [
        str(len(rows)), str(len(maps)), str(len(found)), f"{np.median(errors):.1%}, {np.percentile(errors, 95):.1%}",
        f"{np.median(np.array(sigmas, float)):.1%}", f"{within:.1%}",
        f"{np.median(gravity):.2f}, {np.percentile(gravity, 95):.2f}",
    ]  # fmt: skip


# -- gravity of frames -----------------------------------------------------------------------------


_SCENES = ("room", "wall", "nadir", "desk", "corridor", "handheld")
_OFFSET_DEG, _NOISE_DEG, _WRONG_DEG, _STATED_DEG = 0.5, 0.3, 10.0, 0.7
_GRAVITIES = ("none", "right", "off by 10 degrees", "constant in the camera", "of chance")
_SHARES = (0.1, 0.75)


def run_world(text: str, kind: str, number: int) -> tuple[str, int, float]:
    """The outcome of a drawn world with gravity in its frames, the frames it took, and the error of its gravity."""
    source, rng = open_compared(text), np.random.default_rng((number, 5))
    assert isinstance(source, PointSource)
    truth = dict(zip(source.timestamps_s.tolist(), source.groundtruth.world_from_cam, strict=True))
    first = next(iter(truth.values()))
    down = first.R @ (np.array([0.0, 1.0, 0.0]) + 0.3 * rng.normal(size=3))
    down /= np.linalg.norm(down)
    axis = rng.normal(size=3)
    angle_deg = _WRONG_DEG if kind == "off by 10 degrees" else _OFFSET_DEG
    mount = rotation_from_vector(np.radians(angle_deg) * axis / np.linalg.norm(axis))
    initializer = Initializer(source.camera)
    for observed in source.observations():
        seen = mount @ truth[observed.timestamp_s].R.T @ down + np.radians(_NOISE_DEG) * rng.normal(size=3)
        seen = first.R.T @ down if kind == "constant in the camera" else seen
        seen = rng.normal(size=3) if kind == "of chance" else seen
        gravity = None if kind == "none" else Gravity(seen, _STATED_DEG)
        if initializer.process_tracks(observed, gravity=gravity):
            break
    map_ = initializer.finish().map
    if map_ is None:
        return "none", len(source), np.nan
    outcome = "correct" if is_correct(pose_errors(map_, source.groundtruth), Criteria()) else "false"
    if map_.gravity is None:
        return outcome, initializer.frames_read, np.nan
    at = map_.keyframes[0]
    true_down = at.world_from_cam.R @ truth[at.timestamp_s].R.T @ down
    off_deg = np.degrees(np.arccos(np.clip(map_.gravity.down @ true_down, -1, 1)))
    return outcome, initializer.frames_read, float(off_deg)


def gravity_table(worlds: int, seed: int) -> None:
    """Print the table of gravity in the frames."""
    sys.stdout.write("| outliers | gravity | correct/false/none | frames | maps with gravity, error (median) |\n")
    sys.stdout.write("|---|---|--:|--:|--:|\n")
    for share in _SHARES:
        options = f"baseline=0.15&turning_deg_s=20&speed=0.3&outliers={share}"
        for kind in _GRAVITIES:
            texts = [f"points:{scene}?seed={seed + k}&{options}" for scene in _SCENES for k in range(worlds)]
            found = [run_world(text, kind, number) for number, text in enumerate(texts)]
            outcomes = [outcome for outcome, _, _ in found]
            counts = "/".join(str(outcomes.count(one)) for one in ("correct", "false", "none"))
            errors = np.array([off for _, _, off in found])
            errors = errors[np.isfinite(errors)]
            stated = f"{len(errors)}, {np.median(errors):.2f} deg" if len(errors) else "0"
            frames = np.mean([count for _, count, _ in found])
            sys.stdout.write(f"| {share:.0%} | {kind} | {counts} | {frames:.2f} | {stated} |\n")
            sys.stdout.flush()


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.imu", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--clips", type=positive, default=200, metavar="N", help="of each motion (200)")
    parser.add_argument("--motion", action="append", choices=tuple(KINDS), help="may be repeated; default: all")
    parser.add_argument("--seed", type=int, default=100_000, metavar="N", help="of the first clip (100000)")
    parser.add_argument("--gravity", type=positive, metavar="N", help="only the gravity of frames: N worlds a scene")
    arguments = parser.parse_args(argv)
    if arguments.gravity is not None:
        gravity_table(arguments.gravity, arguments.seed)
        return 0
    rows = {
        name: [run_clip(KINDS[name], arguments.seed + k) for k in range(arguments.clips)]
        for name in arguments.motion or KINDS
    }
    write = sys.stdout.write
    write(
        "| motion | clips | maps | scales | error: median, 95 % | stated | within 95 % | gravity, deg: median, 95 % |\n"
    )
    write("|---|--:|--:|--:|--:|--:|--:|--:|\n")
    for name, part in rows.items():
        write(f"| {name} | {' | '.join(_cells(part))} |\n")
    for low, high in _GROUPS:
        group = [row for part in rows.values() for row in part if low <= row.frames <= high]
        write(f"| {low} to {high} frames | {' | '.join(_cells(group))} |\n")
    every = [row for part in rows.values() for row in part]
    write(f"| all | {' | '.join(_cells(every))} |\n\n")
    write("| record | maps | accepted | off by more than 20 % |\n|---|--:|--:|--:|\n")
    maps = [row for row in every if row.scales]
    for record in maps[0].scales if maps else ():
        errors = [abs(row.errors[record]) for row in maps if record in row.errors]
        write(f"| {record} | {len(maps)} | {len(errors)} | {sum(error > np.log(1.2) for error in errors)} |\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
