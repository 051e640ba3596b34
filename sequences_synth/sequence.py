"""A synthetic sequence: a world, a path and a camera. Each frame is rendered on request."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sequences_synth.camera import PinholeCamera
from sequences_synth.noise import blur_along, expose
from sequences_synth.render import View, render
from sequences_synth.scene import SCENES, World, build_world

__all__ = ["SynthOptions", "SynthSequence", "make_sequence"]

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Bools = NDArray[np.bool_]

# Focal length over image width: 525 px at 640, as of a usual hand-held RGB-D camera. The horizontal field of view is
# 63 degrees.
_FOCAL_BY_WIDTH = 525.0 / 640.0
# The flow of the motion blur is smooth away from silhouettes. It is computed on every fourth pixel of each row and
# column.
_FLOW_STEP = 4


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
        Frames per second. It changes the time stamps, not the motion from frame to frame.
    noise : float
        Standard deviation of the luminance at mid grey, grey levels (shot and read noise).
    motion_blur : float
        Exposure as a fraction of the frame interval, 0 to 1.
    exposure_change : float
        Relative amplitude of a slow change of gain: 0.08 is 8 % up and down.
    focal_error : float
        The stated focal length is the true one times ``1 + focal_error``.
    moving_objects : float
        Approximate share of the image area covered by objects that move on their own, 0 to 0.8.
    slow_start : int
        Number of frames over which the motion rises from rest to full speed.

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

    def __post_init__(self) -> None:
        limits: dict[str, tuple[float, float]] = {
            "frames": (1, 100_000), "width": (64, 4096), "height": (64, 4096), "fps": (1e-3, 1e4), "noise":
            (0, 100), "motion_blur": (0, 1), "exposure_change": (0, 0.9), "focal_error": (-0.9, 10),
            "moving_objects": (0, 0.8), "slow_start": (0, 100_000),
        }  # fmt: skip
        for name in (f.name for f in fields(self)):
            value, (low, high) = getattr(self, name), limits[name]
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name} is {value!r}: it must lie between {low} and {high}")


@dataclass(frozen=True, eq=False)
class SynthSequence:
    """A synthetic sequence. Each frame is rendered on request and does not depend on the frames rendered before.

    Attributes
    ----------
    name : str
    seed : int
    options : SynthOptions
    camera : PinholeCamera
        The stated camera; its focal length is wrong where ``options.focal_error`` is not 0.
    true_camera : PinholeCamera
        The camera by which the images are rendered.
    world : World
    poses : (N, 4, 4) float
        world_from_cam at the middle of each exposure, metres.
    timestamps_s : (N,) float
    """

    name: str
    seed: int
    options: SynthOptions
    camera: PinholeCamera
    true_camera: PinholeCamera
    world: World
    poses: Floats
    timestamps_s: Floats

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
            Depth along the optical axis (z) in metres; 0 where there is no surface.

        Raises
        ------
        IndexError
            If the sequence has no such frame.
        """
        view = self._view(index)
        image = blur_along(view.image, self._half_flow(index, view)) if self.options.motion_blur else view.image
        # The generator is seeded for this frame, so that the frame does not depend on those rendered before.
        rng = np.random.default_rng([self.seed, index, 1])
        image = expose(image, self._gain(index), self.options.noise, rng)
        hit = view.inverse_depth > 0
        depth = np.divide(1, view.inverse_depth, out=np.zeros_like(view.inverse_depth), where=hit)
        return image, depth

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
        return self._moving(self._view(index))

    def _view(self, index: int) -> View:
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of a sequence of {len(self)} frames")
        camera = self.true_camera
        cam_from_world = np.linalg.inv(self.poses[index])
        return render(self.world.quads, camera.K, cam_from_world, index, camera.width, camera.height)

    def _moving(self, view: View) -> Bools:
        moves = np.array([quad.displacement is not None for quad in self.world.quads] + [False])
        return np.asarray(moves[view.ids])

    def _gain(self, index: int) -> float:
        phase, rate = self.world.exposure_phase
        return 1.0 + self.options.exposure_change * math.sin(phase + rate * index)

    def _half_flow(self, index: int, view: View) -> Floats32:
        """(H, W, 2) float32: motion of each pixel from the middle of the exposure to its end."""
        import cv2

        half = 0.5 * self.options.motion_blur
        K = self.true_camera.K
        later_from_now = np.linalg.inv(self.world.path.world_from_cam(index + half)) @ self.poses[index]
        M, k = K @ later_from_now[:3, :3] @ np.linalg.inv(K), K @ later_from_now[:3, 3]
        nodes = slice(_FLOW_STEP // 2, None, _FLOW_STEP)
        rows, columns = (np.arange(size)[nodes] for size in view.ids.shape)
        x, y = np.meshgrid(columns, rows)
        inverse_depth = view.inverse_depth[nodes, nodes].astype(float)
        pixels = np.stack([x, y, np.ones_like(x)], axis=-1).astype(float)
        moved = pixels @ M.T + inverse_depth[..., None] * k
        ids = view.ids[nodes, nodes]
        for i in np.unique(ids[self._moving(view)[nodes, nodes]]).tolist():
            own, quad = ids == i, self.world.quads[i]
            step = quad.corner_at(index + half) - quad.corner_at(index)
            R = np.linalg.inv(self.world.path.world_from_cam(index + half))[:3, :3]
            moved[own] += inverse_depth[own][:, None] * (K @ R @ step)
        flow = (moved[..., :2] / moved[..., 2:] - pixels[..., :2]).astype(np.float32)
        size = (view.ids.shape[1], view.ids.shape[0])
        return np.asarray(cv2.resize(flow, size, interpolation=cv2.INTER_LINEAR), np.float32)


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
        raise ValueError(f"unknown scene {name!r}: use one of {', '.join(SCENES)}")
    if seed < 0:
        raise ValueError(f"seed is {seed}: it must not be negative")
    options = options or SynthOptions()
    width, height = options.width, options.height
    focal = _FOCAL_BY_WIDTH * width
    true_camera = PinholeCamera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    stated = focal * (1 + options.focal_error)
    world = build_world(name, seed, true_camera.K, width, height, options.slow_start, options.moving_objects)
    return SynthSequence(
        name=name,
        seed=seed,
        options=options,
        camera=replace(true_camera, fx=stated, fy=stated),
        true_camera=true_camera,
        world=world,
        poses=np.stack([world.path.world_from_cam(i) for i in range(options.frames)]),
        timestamps_s=np.arange(options.frames) / options.fps,
    )
