"""A synthetic sequence: a world, a path and a camera. Each frame is rendered on request."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from sequences_synth.arrays import Floats, Floats32, Image
from sequences_synth.camera import Shutter, SynthCamera, all_sights, lens_camera, stated_camera
from sequences_synth.inertial import InertialSamples, measure
from sequences_synth.options import SynthOptions, check_scene, stream
from sequences_synth.render import View, render, render_lines
from sequences_synth.scenes import SCENES, build_world
from sequences_synth.texture import Quad

# -- motion blur, exposure, shot and read noise ----------------------------------------------------


# Blur of less than this half length in pixels is skipped: it does not affect feature detectors.
_LEAST_BLUR_PX = 0.1
# An image is averaged over one sample per pixel of the blur, but over no more samples than this.
_MAX_SAMPLES = 9
# Share of the noise variance at mid grey that is read noise. The rest is shot noise, whose variance is proportional to
# the light.
_READ_SHARE = 0.3
_MID_GREY = 128.0


def blur_along(image: Image, half_flow: Floats32) -> Image:
    """Average an image along the motion of its pixels.

    The average is symmetric about the middle of the exposure, so that no feature is displaced.

    Shapes: ``image`` (H, W, 3), ``half_flow`` (H, W, 2), returns (H, W, 3).

    * ``half_flow``: Motion of each pixel from the middle of the exposure to its end, pixels.
    * Returns: The given image itself where the blur is below a tenth of a pixel.
    """
    import cv2

    # The number of samples suits 95 % of the pixels: a few at the border or on near objects have a longer blur.
    longest = float(np.percentile(np.hypot(half_flow[::8, ::8, 0], half_flow[::8, ::8, 1]), 95))
    if longest < _LEAST_BLUR_PX:
        return image
    samples = int(np.clip(np.ceil(2 * longest), 2, _MAX_SAMPLES))
    height, width = image.shape[:2]
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    u, v = np.ascontiguousarray(half_flow[..., 0]), np.ascontiguousarray(half_flow[..., 1])
    total = np.zeros(image.shape, np.uint16)
    # The instants are the middles of equal parts of the exposure.
    for instant in ((2 * np.arange(samples) + 1) / samples - 1).astype(np.float32):
        moved = cv2.remap(image, x + instant * u, y + instant * v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        total += cast(Image, moved)
    return cast(Image, cv2.convertScaleAbs(total, alpha=1 / samples))


def expose(image: Image, gain: float, noise: float, rng: np.random.Generator) -> Image:
    """Apply a gain and sensor noise.

    Shapes: ``image`` (H, W, 3), returns (H, W, 3).

    * ``gain``: Factor on the light.
    * ``noise``: Standard deviation of the luminance at mid grey, grey levels. Shot noise grows with the square root of
      the light; read noise does not depend on the light.
    """
    import cv2

    if noise == 0.0:
        return image if gain == 1.0 else cast(Image, cv2.convertScaleAbs(image, alpha=gain))
    grey = np.arange(256) * gain
    sigma = noise * np.sqrt(_READ_SHARE + (1 - _READ_SHARE) * grey / _MID_GREY)
    # The three channels share one draw: the luminance then has the requested noise, at a third of the cost. The green
    # channel is taken as the amount of light.
    grain = rng.standard_normal(image.shape[:2], np.float32) * sigma.astype(np.float32)[image[..., 1]]
    noisy = cv2.merge([grain, grain, grain])
    noisy = cv2.scaleAdd(image.astype(np.float32), gain, noisy)
    # This rounds and saturates.
    return cast(Image, np.clip(noisy + np.float32(0.5), 0, 255).astype(np.uint8))


# -- the sequence ----------------------------------------------------------------------------------


# Focal length over image width: 525 px at 640, as of a usual hand-held RGB-D camera. The horizontal field of view is
# 63 degrees.
_FOCAL_BY_WIDTH = 525.0 / 640.0
# Rate of an inertial sensor, and the time that it is on before the first and after the last frame.
_INERTIAL_HZ, _MARGIN_S = 200.0, 0.1
# The flow of the motion blur is smooth away from silhouettes. It is computed on every fourth pixel of each row and
# column.
_FLOW_STEP = 4


@dataclass(frozen=True, eq=False)
class Sensor:
    """A camera on its path through a world: one frame with its rolling shutter, lens and motion blur."""

    #: The true camera.
    camera: SynthCamera
    shutter: Shutter
    #: Frames per second.
    fps: float
    #: Exposure as a fraction of the frame interval: the image is blurred along its flow.
    motion_blur: float
    #: All surfaces of the world.
    quads: Sequence[Quad]
    #: Frame number, not necessarily whole -> true pose world_from_cam (4, 4).
    pose: Callable[[float], Floats]
    #: (float, float) The exposure changes slowly as a sine: its phase at frame 0 and its advance per frame, radians.
    exposure_phase: tuple[float, float]

    def expose(self, frame: int) -> View:
        """Render a frame with its motion blur; depth and ids are those of the middle of the exposure.

        * Returns: With a lens camera its inverse depth is the inverse distance along the ray.
        """
        camera = self.camera
        # One homography for each surface is enough with a global shutter and without a lens.
        if camera.is_pinhole and self.shutter.readout_s == 0.0:
            cam_from_world = np.asarray(np.linalg.inv(self.pose(frame)), float)
            view = render(self.quads, camera.K, cam_from_world, camera.width, camera.height)
        else:
            view = render_lines(self.quads, camera, partial(self._frames_of, frame), self.pose)
        if self.motion_blur == 0:
            return view
        return replace(view, image=blur_along(view.image, self._half_flow(frame, view)))

    def depth(self, view: View) -> Floats32:
        """Compute the depths of a view.

        Shapes: returns (H, W).

        * Returns: Along the optical axis (z) in metres; 0 where there is no surface, or a surface behind the image
          plane.
        """
        hit = view.inverse_depth > 0
        depth = np.divide(1, view.inverse_depth, out=np.zeros_like(view.inverse_depth), where=hit)
        if not self.camera.is_pinhole:
            depth = np.asarray(depth * np.maximum(all_sights(self.camera, 1)[2], 0.0), np.float32)
        return depth

    def _frames_of(self, frame: float, rows: Floats) -> Floats:
        """Frame numbers at which rows are exposed."""
        return frame + self.fps * self.shutter.row_delay_s(rows)

    def _half_flow(self, frame: int, view: View) -> Floats32:
        """(H, W, 2): motion of each pixel from the middle of the exposure to its end, with the pose of its row."""
        import cv2

        half = 0.5 * self.motion_blur
        nodes = slice(_FLOW_STEP // 2, None, _FLOW_STEP)
        height, width = view.inverse_depth.shape
        x, y = np.meshgrid(np.arange(width, dtype=float)[nodes], np.arange(height, dtype=float)[nodes])
        inverse_depth = view.inverse_depth[nodes, nodes].astype(float)[..., None]
        frames, rows = np.unique(self._frames_of(frame, y[:, 0]), return_inverse=True)
        now, later = (np.stack([self.pose(float(f + shift)) for f in frames])[rows][:, None] for shift in (0.0, half))
        pixels = np.stack([x, y], axis=-1)
        rays = self.camera.rays(pixels)
        # Homogeneous world points (ray + centre / z, 1 / z), so that a pixel without surface is infinitely far away.
        X = np.concatenate([_turn(now[..., :3, :3], rays), np.zeros_like(inverse_depth)], axis=-1)
        X += inverse_depth * now[..., :, 3]
        cam = np.asarray(np.linalg.inv(later), float)
        moved = _turn(cam[..., :3, :3], X[..., :3]) + X[..., 3:] * cam[..., :3, 3]
        if self.camera.is_pinhole:
            moved[..., 2] = np.maximum(moved[..., 2], 1e-3)
        # A pixel outside of the field of view does not move.
        flow = np.nan_to_num(self.camera.project(moved) - pixels).astype(np.float32)
        return np.asarray(cv2.resize(flow, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def _turn(R: Floats, X: Floats) -> Floats:
    """Rotations (..., 3, 3) times vectors (..., 3)."""
    return np.asarray((R @ X[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class SynthSequence:
    """A synthetic sequence. Each frame is rendered on request and does not depend on the frames rendered before.

    Attributes
    ----------
    name : str
    seed : int
    options : SynthOptions
    camera : SynthCamera
        The stated camera, which has the errors of the options and no distortion besides that of the lens.
    poses : (N, 4, 4) float
        world_from_cam at the middle row and the middle of each exposure, metres. After a cut the world is another one.
    timestamps_s : (N,) float
        Time of the middle row.
    sensors : tuple of Sensor
        The true camera, path, shutter and world of each scene.
    """

    name: str
    seed: int
    options: SynthOptions
    camera: SynthCamera
    poses: Floats
    timestamps_s: Floats
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
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of a sequence of {len(self)} frames")
        scene = int(0 < self.options.cut <= index)
        sensor = self.sensors[scene]
        view = sensor.expose(index - scene * self.options.cut)
        # The generator is seeded for this frame, so that the frame does not depend on those rendered before.
        phase, rate = self.sensors[0].exposure_phase
        gain = 1.0 + self.options.exposure_change * math.sin(phase + rate * index)
        image = expose(view.image, gain, self.options.noise, np.random.default_rng([self.seed, index, 1]))
        return image, sensor.depth(view)

    def inertial(self) -> InertialSamples | None:
        """Measure with the inertial sensor, from 0.1 s before the first frame to 0.1 s after the last one.

        Returns
        -------
        InertialSamples or None
            None without the option ``imu``.
        """
        if not self.options.imu:
            return None
        pose, fps = self.sensors[0].pose, self.options.fps
        last_s = float(self.timestamps_s[-1]) + _MARGIN_S
        times_s = np.arange(-_MARGIN_S, last_s, 1 / _INERTIAL_HZ)
        rng = stream(self.seed, b"inertial sensor ", self.name)
        return measure(lambda time_s: pose(time_s * fps), times_s, rng)


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
    pinhole = SynthCamera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    ideal = pinhole if options.lens == "pinhole" else lens_camera(options.lens, width, height)
    true_camera = pinhole.bent(options.k1) if options.lens == "pinhole" else ideal
    shutter = Shutter(options.readout_ms / 1000, options.readout_direction, width, height)
    sensors, poses = [], []
    lengths = (options.cut, options.frames - options.cut) if options.cut else (options.frames,)
    for number, frames in enumerate(lengths):
        entropy = (seed, *number * b"after the cut ", *name.encode())
        world = build_world(name, entropy, pinhole.K, options)
        sensors.append(Sensor(true_camera, shutter, options.fps, options.motion_blur, *world))
        poses += [sensors[-1].pose(frame) for frame in range(frames)]
    rng = stream(seed, b"principal point ", name)
    return SynthSequence(
        name=name,
        seed=seed,
        options=options,
        camera=stated_camera(ideal, options.focal_error, options.principal_error, rng),
        poses=np.stack(poses),
        timestamps_s=np.arange(options.frames) / options.fps,
        sensors=tuple(sensors),
    )
