"""A synthetic sequence: a world, a path and a camera. Each frame is rendered on request."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sequences_synth.camera import PinholeCamera, stated_camera
from sequences_synth.hand_motion import Handling
from sequences_synth.lens_camera import LENSES, LensCamera, lens_camera
from sequences_synth.limits import EFFECT_LIMITS, check_options, unknown_scene
from sequences_synth.noise import expose
from sequences_synth.scene import SCENES, Motions, World, build_world
from sequences_synth.schedule import Schedule
from sequences_synth.sensor import Sensor
from sequences_synth.shutter import Shutter

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Bools = NDArray[np.bool_]

# Focal length over image width: 525 px at 640, as of a usual hand-held RGB-D camera. The horizontal field of view is
# 63 degrees.
_FOCAL_BY_WIDTH = 525.0 / 640.0
# The angular speed of hand-held turning is a root mean square over this time. It does not depend on the number of
# frames, so that a longer sequence continues the path of a shorter one.
_HANDLING_S = 10.0
# Lamps flicker at twice the frequency of the mains, 50 or 60 Hz.
_LAMPS_HZ = (100.0, 120.0)


_LIMITS = EFFECT_LIMITS | {
    "frames": (1, 100_000), "width": (64, 4096), "height": (64, 4096), "noise": (0, 100), "motion_blur": (0, 1),
    "exposure_change": (0, 0.9), "moving_objects": (0, 0.8), "slow_start": (0, 100_000), "moving": (0, 0.8),
    "bodies": (1, 20), "flicker": (0, 0.9), "fade": (0, 100_000), "cut": (0, 100_000), "tag_m": (0, 100),
}  # fmt: skip


@dataclass(frozen=True)
class SynthOptions:
    """Options of camera and world; the same for every scene.

    Attributes
    ----------
    frames : int
        Number of frames. A longer sequence continues the path of a shorter one.
    width, height : int
        Image size in pixels.
    fps : float
        Frames per second. It changes the time stamps, not the motion from frame to frame. Only in the scenes
        ``handheld``, ``handheld-wall`` and ``pan`` it decides how far the camera turns from frame to frame.
    noise : float
        Standard deviation of the luminance at mid grey, grey levels (shot and read noise).
    motion_blur : float
        Exposure as a fraction of the frame interval, 0 to 1: each image is blurred along its flow. Ignored if
        ``exposure_ms`` is not 0.
    exposure_change : float
        Relative amplitude of a slow change of gain: 0.08 is 8 % up and down.
    focal_error : float
        The stated focal length is the true one times ``1 + focal_error``.
    moving_objects : float
        Approximate share of the image area covered by objects that move on their own, 0 to 0.8.
    slow_start : int
        Number of frames over which the motion rises from rest to full speed. The scenes ``handheld``,
        ``handheld-wall`` and ``pan`` move from the first frame on.
    readout_ms : float
        Readout time of the rolling shutter, at most a frame interval; 0 for a global shutter. See
        :mod:`sequences_synth.shutter`.
    readout_direction : str
        Order in which rows or columns are read: ``down``, ``up``, ``right`` or ``left``.
    exposure_ms : float
        Exposure time, at most a frame interval: each image is the mean of renders along the true path, about one per
        pixel of blur.
    turning_deg_s : float
        Root mean square of the angular speed in the scenes ``handheld`` and ``handheld-wall``, over 10 s, and speed of
        the scene ``pan``. The other scenes ignore it.
    speed : float
        Speed of the translation in the scenes ``handheld`` and ``handheld-wall``, median depths per second. The median
        depth of the room is taken as 3 m. The other scenes ignore it.
    moving : float
        Share of the view that bodies fill, 0 to 0.8. The bodies are boards that follow the gaze of the camera, sway and
        turn.
    bodies : int
        Number of these bodies.
    body_turn_deg_s : float
        Root mean square of the angular speed of a body about its own vertical axis, with respect to the camera.
    principal_error : float
        Error of the stated principal point: horizontally over the width, vertically over the height. The signs are
        drawn.
    k1 : float
        Coefficient of radial distortion of the true camera, which the stated camera lacks.
    lens : str
        ``pinhole``, or one of :data:`sequences_synth.lens_camera.LENSES`, with usual parameters that the stated camera
        has as well. It has no ``k1``, and its frames are not ``stabilized``.
    flicker : float
        Relative amplitude of the flicker of lamps, at 100 or 120 Hz, whichever changes more from frame to frame. A
        rolling shutter shows it as bands.
    fade : int
        Number of frames over which the sequence rises from black and, at its end and before a cut, falls to black.
    stabilized : bool
        Whether each frame is warped to a smoothed path, see :mod:`sequences_synth.stabilizer`. The true poses are then
        those of the virtual camera.
    dropped : float
        Share of the frames that are missing. The frames that are left are ``frames``, and their time stamps jump.
    repeated : float
        Share of the frames that repeat the frame before, with a new time stamp. The true pose of such a frame is that
        of the frame that it repeats.
    cut : int
        Position of the frame at which another scene of the same kind begins; 0 for none. The poses of the second scene
        have the world frame of the second scene: they have no relation to those before.
    tag_m : float
        Side of the black square of an AprilTag (family 36h11, number 7) on a board in front of the scene, metres; 0 for
        none.

    Raises
    ------
    ValueError
        If an option is out of range; the message names the option.
    """

    frames: int = 100
    width: int = 640
    height: int = 480
    fps: float = 30.0
    noise: float = 3.0
    motion_blur: float = 0.3
    exposure_change: float = 0.06
    focal_error: float = 0.0
    moving_objects: float = 0.0
    slow_start: int = 12
    readout_ms: float = 0.0
    readout_direction: str = "down"
    exposure_ms: float = 0.0
    turning_deg_s: float = 60.0
    speed: float = 0.0
    moving: float = 0.0
    bodies: int = 1
    body_turn_deg_s: float = 30.0
    principal_error: float = 0.0
    k1: float = 0.0
    lens: str = "pinhole"
    flicker: float = 0.0
    fade: int = 0
    stabilized: bool = False
    dropped: float = 0.0
    repeated: float = 0.0
    cut: int = 0
    tag_m: float = 0.0

    def __post_init__(self) -> None:
        check_options(self, _LIMITS)
        if self.cut >= self.frames:
            raise ValueError(f"cut is {self.cut}: it must be less than the number of frames, {self.frames}")
        if self.lens not in ("pinhole", *LENSES):
            raise ValueError(f"lens is {self.lens!r}: use one of pinhole, {', '.join(LENSES)}")
        if self.lens != "pinhole" and (self.k1 or self.stabilized):
            raise ValueError(f"lens is {self.lens!r}: k1 and stabilized need lens=pinhole")


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

    def _sensor(self, index: int) -> tuple[Sensor, int]:
        """The sensor of a frame, and the frame number on its path."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of a sequence of {len(self)} frames")
        scene = int(0 < self.schedule.cut <= index)
        shown, first = self.schedule.content[index], scene * self.schedule.cut
        return self.sensors[scene], int(self.schedule.ticks[shown] - self.schedule.ticks[first])

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
    if name not in SCENES:
        raise ValueError(unknown_scene(name, SCENES))
    if seed < 0:
        raise ValueError(f"seed is {seed}: it must not be negative")
    options = options or SynthOptions()
    width, height = options.width, options.height
    focal = _FOCAL_BY_WIDTH * width
    pinhole = PinholeCamera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, options.k1)
    true_camera = pinhole if options.lens == "pinhole" else lens_camera(options.lens, width, height)
    schedule = Schedule.draw(
        np.random.default_rng((seed, *b"schedule ", *name.encode())),
        options.frames,
        options.dropped,
        options.repeated,
        options.cut,
    )
    worlds = []
    for number in range(len(schedule.scenes)):
        entropy = (seed, *number * b"after the cut ", *name.encode())
        worlds.append(build_world(name, entropy, pinhole.K, width, height, _motions(options)))
    sensors = tuple(_sensor(true_camera, world, options) for world in worlds)
    poses = []
    for sensor, frames in zip(sensors, schedule.scenes, strict=True):
        poses += [sensor.pose(int(tick - schedule.ticks[frames.start])) for tick in schedule.ticks[frames]]
    return SynthSequence(
        name=name,
        seed=seed,
        options=options,
        camera=stated_camera(
            true_camera,
            options.focal_error,
            options.principal_error,
            np.random.default_rng((seed, *b"principal point ", *name.encode())),
        ),
        true_camera=true_camera,
        world=worlds[0],
        poses=np.stack(poses)[schedule.content],
        timestamps_s=schedule.ticks / options.fps,
        schedule=schedule,
        sensors=sensors,
    )


def _motions(options: SynthOptions) -> Motions:
    return Motions(
        slow_start=options.slow_start,
        fps=options.fps,
        handling=Handling(_HANDLING_S, options.turning_deg_s, options.speed),
        cards=options.moving_objects,
        boards=options.moving,
        bodies=options.bodies,
        body_turn_deg_s=options.body_turn_deg_s,
        tag_m=options.tag_m,
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
