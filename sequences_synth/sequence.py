"""A synthetic sequence: a world, a path and a camera. Each frame is rendered on request."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Bools, Floats, Floats32, Image
from sequences_synth.camera import LensCamera, PinholeCamera, lens_camera, stated_camera
from sequences_synth.inertial import InertialSamples, measure
from sequences_synth.noise import expose
from sequences_synth.options import SynthOptions, check_scene
from sequences_synth.scene import SCENES, World, build_world
from sequences_synth.schedule import Schedule, stream
from sequences_synth.sensor import Sensor
from sequences_synth.shutter import Shutter

# Focal length over image width: 525 px at 640, as of a usual hand-held RGB-D camera. The horizontal field of view is
# 63 degrees.
_FOCAL_BY_WIDTH = 525.0 / 640.0
# Lamps flicker at twice the frequency of the mains, 50 or 60 Hz.
_LAMPS_HZ = (100.0, 120.0)
# Rate of an inertial sensor, and the time that it is on before the first and after the last frame.
_INERTIAL_HZ, _MARGIN_S = 200.0, 0.1


@dataclass(frozen=True, eq=False)
class SynthSequence:
    """A synthetic sequence. Each frame is rendered on request and does not depend on the frames rendered before.

    Attributes
    ----------
    name : str
    seed : int
    options : SynthOptions
    camera : PinholeCamera or LensCamera
        The stated camera, which has the errors of the options and no distortion besides that of the lens.
    true_camera : PinholeCamera or LensCamera
        The camera by which the images are rendered.
    world : World
        That of the first scene.
    poses : (N, 4, 4) float
        world_from_cam at the middle row and the middle of each exposure, metres. After a cut the world is another one.
    timestamps_s : (N,) float
        Time of the middle row.
    schedule : Schedule
        Dropped and repeated frames, and the cut.
    sensors : tuple of Sensor
        The true camera, path, shutter and world of each scene.
    """

    name: str
    seed: int
    options: SynthOptions
    camera: PinholeCamera | LensCamera
    true_camera: PinholeCamera | LensCamera
    world: World
    poses: Floats
    timestamps_s: Floats
    schedule: Schedule
    sensors: tuple[Sensor, ...]

    def __len__(self) -> int:
        return len(self.poses)

    def render(self, index: int) -> tuple[Image, Floats32]:
        """Render one frame.

        Parameters
        ----------
        index : int
            Position of the frame, from 0.

        Returns
        -------
        image : (H, W, 3) uint8
            BGR.
        depth : (H, W) float32
            Depth along the optical axis (z) in metres; 0 where there is no surface, or one behind the image plane.

        Raises
        ------
        IndexError
            If the sequence has no such frame.
        """
        sensor, frame = self._sensor(index)
        view = sensor.expose(frame)
        # A repeated frame is the same image. The generator is seeded for this frame, so that the frame does not depend
        # on those rendered before.
        shown = int(self.schedule.content[index])
        rng = np.random.default_rng([self.seed, shown, 1])
        image = expose(view.image, self._gain(shown), self.options.noise, rng)
        return image, sensor.depth(view)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[tuple[int, float, Image, Floats32, Floats]]:
        """Render frames in order.

        Parameters
        ----------
        start : int
            Position of the first frame.
        stop : int, optional
            Position after the last frame; by default the end of the sequence.

        Yields
        ------
        index : int
        timestamp_s : float
        image : (H, W, 3) uint8
        depth : (H, W) float32
            As of :meth:`render`.
        world_from_cam : (4, 4) float
        """
        for index in range(len(self))[start:stop]:
            image, depth = self.render(index)
            yield index, float(self.timestamps_s[index]), image, depth, self.poses[index]

    def moving_mask(self, index: int) -> Bools:
        """Find the pixels of moving objects in one frame.

        Parameters
        ----------
        index : int
            Position of the frame, from 0.

        Returns
        -------
        (H, W) bool
            True on objects that move on their own.

        Raises
        ------
        IndexError
            If the sequence has no such frame.
        """
        sensor, frame = self._sensor(index)
        moves = np.array([quad.moves for quad in sensor.quads] + [False])
        return np.asarray(moves[sensor.view(frame).ids])

    def pixel_poses(self, index: int, pixels: Floats) -> Floats:
        """Compute the poses that the camera had when it exposed pixels of one frame.

        Parameters
        ----------
        index : int
            Position of the frame, from 0.
        pixels : (N, 2) float

        Returns
        -------
        (N, 4, 4) float
            Poses world_from_cam, of the virtual camera in a stabilized frame. With a global shutter all are the pose of
            the frame.

        Raises
        ------
        IndexError
            If the sequence has no such frame.
        """
        sensor, frame = self._sensor(index)
        return sensor.pixel_poses(frame, pixels)

    def inertial(self) -> InertialSamples | None:
        """Measure with the inertial sensor, from 0.1 s before the first frame to 0.1 s after the last one.

        Returns
        -------
        InertialSamples or None
            None without the option ``imu``.
        """
        if not self.options.imu:
            return None
        path, fps = self.sensors[0].path, self.options.fps
        last_s = float(self.timestamps_s[-1]) + _MARGIN_S
        times_s = np.arange(-_MARGIN_S, last_s, 1 / _INERTIAL_HZ)
        rng = stream(self.seed, b"inertial sensor ", self.name)
        return measure(lambda time_s: path.world_from_cam(time_s * fps), times_s, rng)

    def _sensor(self, index: int) -> tuple[Sensor, int]:
        """The sensor of a frame, and the frame number on its path."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of a sequence of {len(self)} frames")
        scene, tick = self.schedule.shown(index)
        return self.sensors[scene], tick

    def _gain(self, index: int) -> float | Floats:
        """Factor on the light of one frame; of each of its lines where the flicker of lamps makes bands."""
        phase, rate = self.world.exposure_phase
        gain = 1.0 + self.options.exposure_change * math.sin(phase + rate * index)
        if self.options.fade:
            gain *= self._faded(index)
        if not self.options.flicker:
            return gain
        shutter, fps = self.sensors[0].shutter, self.options.fps

        def change(hertz: float) -> float:
            return abs(hertz / fps - round(hertz / fps))

        lamp_hz = max(_LAMPS_HZ, key=change)
        times_s = self.timestamps_s[index] + shutter.line_delay_s(np.arange(shutter.lines, dtype=float))
        light = 1.0 + self.options.flicker * np.sin(phase + 2 * np.pi * lamp_hz * times_s)
        return np.asarray(gain * (light[None, :] if shutter.by_columns else light[:, None]))

    def _faded(self, index: int) -> float:
        """Light of a frame between black, 0, and full, 1."""
        frames = next(f for f in self.schedule.scenes if f.start <= index < f.stop)
        return float(min(1.0, (min(index - frames.start, frames.stop - 1 - index) + 1) / (self.options.fade + 1)))


def make_sequence(name: str, seed: int = 0, options: SynthOptions | None = None) -> SynthSequence:
    """Make a synthetic sequence.

    Parameters
    ----------
    name : str
        One of :data:`SCENES`.
    seed : int
        Changes geometry, textures, path and noise; not negative.
    options : SynthOptions, optional

    Returns
    -------
    SynthSequence

    Raises
    ------
    ValueError
        If the scene is unknown (the message lists the known ones), or if the seed is negative.
    """
    check_scene(name, seed, SCENES)
    options = options or SynthOptions()
    width, height = options.width, options.height
    focal = _FOCAL_BY_WIDTH * width
    pinhole = PinholeCamera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, options.k1)
    true_camera = pinhole if options.lens == "pinhole" else lens_camera(options.lens, width, height)
    schedule = Schedule.draw(stream(seed, b"schedule ", name), options.frames, options)
    worlds = []
    for number in range(len(schedule.scenes)):
        entropy = (seed, *number * b"after the cut ", *name.encode())
        worlds.append(build_world(name, entropy, pinhole.K, options))
    sensors = tuple(_sensor(true_camera, world, options) for world in worlds)
    poses = []
    for sensor, frames in zip(sensors, schedule.scenes, strict=True):
        poses += [sensor.pose(int(tick - schedule.ticks[frames.start])) for tick in schedule.ticks[frames]]
    return SynthSequence(
        name=name,
        seed=seed,
        options=options,
        camera=stated_camera(
            true_camera, options.focal_error, options.principal_error, stream(seed, b"principal point ", name)
        ),
        true_camera=true_camera,
        world=worlds[0],
        poses=np.stack(poses)[schedule.content],
        timestamps_s=schedule.ticks / options.fps,
        schedule=schedule,
        sensors=sensors,
    )


def _sensor(camera: PinholeCamera | LensCamera, world: World, options: SynthOptions) -> Sensor:
    return Sensor(
        camera=camera,
        shutter=Shutter(options.readout_ms / 1000, options.readout_direction, camera.width, camera.height),
        fps=options.fps,
        motion_blur=options.motion_blur,
        exposure_s=options.exposure_ms / 1000,
        stabilized=options.stabilized,
        quads=world.quads,
        path=world.path,
    )
