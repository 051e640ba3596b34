"""The sensor: one frame of a world with rolling shutter, lens, motion blur and electronic stabilization.

A frame is rendered by :mod:`sequences_synth.render` where one homography per surface is enough: with a global shutter
and without distortion. Otherwise each row is rendered with its own pose, and with a
:class:`~sequences_synth.camera.LensCamera` each sample by its own ray (:mod:`sequences_synth.render_lines`).

A stabilized frame is rendered on a larger sensor, then warped and cropped. The rows beyond the border of the frame are
exposed before and after those within it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from sequences_synth.arrays import Floats, Floats32, Image
from sequences_synth.camera import LensCamera, PinholeCamera, sample_rays
from sequences_synth.noise import blur_along
from sequences_synth.render import View, render
from sequences_synth.render_lines import render_lines
from sequences_synth.shutter import Shutter
from sequences_synth.stabilizer import LARGEST_WARP_RAD, virtual_from_cam
from sequences_synth.textured_quad import Quad

# The flow of the motion blur is smooth away from silhouettes. It is computed on every fourth pixel of each row and
# column.
_FLOW_STEP = 4
# A long exposure is the mean of renders whose image moves by this much from one to the next: trails of corners then
# show no steps. The number of renders is bounded; a longer blur has longer steps.
_BLUR_STEP_PX = 1.0
_MAX_RENDERS = 32
# The border of the larger sensor of a stabilized camera, over what its largest warp moves the centre of the image. The
# corners move by up to twice as much.
_BORDER = 2.0


class CameraPath(Protocol):
    """The path of a camera."""

    def world_from_cam(self, frame: float) -> Floats:
        """Compute the pose at a frame.

        Shapes: returns (4, 4).
        """


@dataclass(frozen=True, eq=False)
class Sensor:
    """A camera on its path through a world."""

    #: The true camera.
    camera: PinholeCamera | LensCamera
    shutter: Shutter
    #: Frames per second.
    fps: float
    #: Exposure as a fraction of the frame interval, if ``exposure_s`` is 0: the image is blurred along its flow.
    motion_blur: float
    #: Exposure time: the frame is the mean of renders along the true path.
    exposure_s: float
    #: Whether frames are warped to a smoothed path; of a pinhole camera only.
    stabilized: bool
    #: The world.
    quads: Sequence[Quad]
    path: CameraPath

    def pose(self, frame: int) -> Floats:
        """Compute the true pose of a frame: of the camera, or of the virtual camera of a stabilized frame.

        Shapes: returns (4, 4).
        """
        pose = self.path.world_from_cam(frame)
        if self.stabilized:
            pose[:3, :3] = pose[:3, :3] @ self._warp(frame).T
        return pose

    def view(self, frame: int) -> View:
        """Render a sharp frame."""
        return self._stabilize(frame, self._expose(frame))

    def expose(self, frame: int) -> View:
        """Render a frame with its motion blur; depth and ids are those of the middle of the exposure.

        * Returns: With a lens camera its inverse depth is the inverse distance along the ray.
        """
        view = self._expose(frame)
        if self.exposure_s > 0:
            view = replace(view, image=self._long_exposure(frame, view))
        elif self.motion_blur > 0:
            view = replace(view, image=blur_along(view.image, self._half_flow(frame, view, 0.5 * self.motion_blur)))
        return self._stabilize(frame, view)

    def pixel_poses(self, frame: int, pixels: Floats) -> Floats:
        """Compute the poses that the camera had when it exposed pixels.

        Shapes: ``pixels`` (N, 2), returns (N, 4, 4).

        * Returns: Poses world_from_cam, of the virtual camera in a stabilized frame, metres.
        """
        warp = self._warp(frame) if self.stabilized else np.eye(3)
        exposed = self.camera.project(self.camera.rays(pixels) @ warp) if self.stabilized else pixels
        frames = frame + self.fps * self.shutter.delay_s(exposed)
        poses = np.stack([self.path.world_from_cam(float(f)) for f in frames])
        poses[:, :3, :3] = poses[:, :3, :3] @ warp.T
        return poses

    def depth(self, view: View) -> Floats32:
        """Compute the depths of a view.

        Shapes: returns (H, W).

        * Returns: Along the optical axis (z) in metres; 0 where there is no surface, or a surface behind the image
          plane.
        """
        hit = view.inverse_depth > 0
        depth = np.divide(1, view.inverse_depth, out=np.zeros_like(view.inverse_depth), where=hit)
        if isinstance(self.camera, LensCamera):
            depth = np.asarray(depth * np.maximum(sample_rays(self.camera, 1)[..., 2], 0.0), np.float32)
        return depth

    @property
    def _border_px(self) -> int:
        """Width of the border of the larger sensor of a stabilized camera."""
        return math.ceil(_BORDER * LARGEST_WARP_RAD * self.camera.fx) if self.stabilized else 0

    @property
    def _whole(self) -> PinholeCamera | LensCamera:
        """The camera with its border."""
        c, border = self.camera, self._border_px
        if border == 0 or isinstance(c, LensCamera):
            return c
        return replace(c, width=c.width + 2 * border, height=c.height + 2 * border, cx=c.cx + border, cy=c.cy + border)

    def _frames_of(self, frame: float, lines: Floats) -> Floats:
        """Frame numbers at which rows (or columns) of the sensor are exposed."""
        return frame + self.fps * self.shutter.line_delay_s(lines - self._border_px)

    def _expose(self, frame: float) -> View:
        """One sharp view of the whole sensor."""
        camera = self._whole
        if isinstance(camera, PinholeCamera) and self.shutter.readout_s == 0.0 and camera.k1 == 0.0:
            cam_from_world = np.asarray(np.linalg.inv(self.path.world_from_cam(frame)), float)
            return render(self.quads, camera.K, cam_from_world, frame, camera.width, camera.height)
        frames_of = partial(self._frames_of, frame)
        return render_lines(self.quads, camera, self.shutter.by_columns, frames_of, self.path.world_from_cam)

    def _long_exposure(self, frame: int, view: View) -> Image:
        """Mean of renders over the exposure."""
        half_frames = 0.5 * self.exposure_s * self.fps
        flow = self._half_flow(frame, view, half_frames)
        # A few pixels at the border or on near objects have a longer blur.
        length_px = 2 * float(np.percentile(np.hypot(flow[::8, ::8, 0], flow[::8, ::8, 1]), 95))
        count = int(np.clip(math.ceil(length_px / _BLUR_STEP_PX), 1, _MAX_RENDERS))
        if count == 1:
            return view.image
        total = np.zeros(view.image.shape, np.float32)
        # The instants are the middles of equal parts of the exposure.
        for instant in (2 * np.arange(count) + 1) / count - 1:
            total += self._expose(frame + half_frames * instant).image
        return cast(Image, (total / count + np.float32(0.5)).astype(np.uint8))

    def _half_flow(self, frame: int, view: View, half_frames: float) -> Floats32:
        """(H, W, 2) float32: motion of each pixel from the middle of the exposure to its end."""
        import cv2

        camera, bodies = self._whole, any(quad.body is not None for quad in self.quads)
        if isinstance(camera, PinholeCamera) and self.shutter.readout_s == 0.0 and camera.k1 == 0.0 and not bodies:
            flow = self._global_flow(camera.K, frame, view, half_frames)
        else:
            flow = self._line_flow(frame, view, half_frames)
        size = (view.ids.shape[1], view.ids.shape[0])
        return np.asarray(cv2.resize(flow.astype(np.float32), size, interpolation=cv2.INTER_LINEAR), np.float32)

    def _global_flow(self, K: Floats, frame: int, view: View, half_frames: float) -> Floats:
        """Flow at the nodes, by one homography for the background and one shift for each quad that moves."""
        later = self.path.world_from_cam(frame + half_frames)
        later_from_now = np.linalg.inv(later) @ self.path.world_from_cam(frame)
        M, k = K @ later_from_now[:3, :3] @ np.linalg.inv(K), K @ later_from_now[:3, 3]
        pixels, inverse_depth, ids = _nodes(view)
        moved = pixels @ M.T + inverse_depth[..., None] * k
        R = np.linalg.inv(later)[:3, :3]
        for i in np.unique(ids[ids >= 0]).tolist():
            own, quad = ids == i, self.quads[i]
            if quad.moves:
                step = quad.corner_at(frame + half_frames) - quad.corner_at(frame)
                moved[own] += inverse_depth[own][:, None] * (K @ R @ step)
        return np.asarray(moved[..., :2] / moved[..., 2:] - pixels[..., :2])

    def _line_flow(self, frame: int, view: View, half_frames: float) -> Floats:
        """Flow at the nodes, with the pose of each line."""
        camera = self._whole
        pixels, inverse_depth, ids = _nodes(view)
        lines = pixels[0, :, 0] if self.shutter.by_columns else pixels[:, 0, 1]
        frames = self._frames_of(frame, lines)
        now, later = (
            np.stack([self.path.world_from_cam(float(f + shift)) for f in frames]) for shift in (0.0, half_frames)
        )
        if self.shutter.by_columns:
            now, later = now[None], later[None]
        else:
            now, later = now[:, None], later[:, None]
        rays = camera.rays(pixels[..., :2])
        # Homogeneous world points (ray + centre / z, 1 / z), so that a pixel without surface is infinitely far away.
        X = np.concatenate([_turn(now[..., :3, :3], rays), np.zeros((*rays.shape[:2], 1))], axis=-1)
        X += inverse_depth[..., None] * now[..., :, 3]
        for i in np.unique(ids[ids >= 0]).tolist():
            own, quad = ids == i, self.quads[i]
            if quad.moves:
                # The pose of a body changes little within the readout: its motion is that at the middle row.
                X[own] = X[own] @ quad.motion(frame, frame + half_frames).T
        cam = np.asarray(np.linalg.inv(later), float)
        moved = _turn(cam[..., :3, :3], X[..., :3]) + X[..., 3:] * cam[..., :3, 3]
        if isinstance(camera, LensCamera):
            # A pixel outside of the field of view does not move.
            return np.nan_to_num(camera.project(moved) - pixels[..., :2])
        moved[..., 2] = np.maximum(moved[..., 2], 1e-3)
        return camera.project(moved) - pixels[..., :2]

    def _warp(self, frame: int) -> Floats:
        return virtual_from_cam(lambda time_s: self.path.world_from_cam(time_s * self.fps)[:3, :3], frame / self.fps)

    def _stabilize(self, frame: int, view: View) -> View:
        """Warp and crop the view of the whole sensor."""
        import cv2

        if not self.stabilized:
            return view
        virtual = self._warp(frame)
        x, y = np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height))
        rays = self.camera.rays(np.stack([x, y], axis=-1).astype(float))
        # The transposed matrix of a rotation is its inverse.
        maps = np.moveaxis(self._whole.project(rays @ virtual).astype(np.float32), -1, 0)
        x, y = np.ascontiguousarray(maps[0]), np.ascontiguousarray(maps[1])
        image = cv2.remap(view.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        inverse_depth = cv2.remap(view.inverse_depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
        ids = cv2.remap(view.ids, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=-1)
        # 1 / z in the virtual camera: the point is (ray of the true camera) z, and its virtual z is that of a ray with
        # z = 1 over the true z of this ray.
        scale = (rays @ virtual)[..., 2]
        return View(cast(Image, image), np.asarray(inverse_depth * scale, np.float32), np.asarray(ids, np.int16))


def _nodes(view: View) -> tuple[Floats, Floats, NDArray[np.int16]]:
    """Homogeneous pixels (h, w, 3), inverse depths (h, w) and ids (h, w) of the nodes."""
    nodes = slice(_FLOW_STEP // 2, None, _FLOW_STEP)
    rows, columns = (np.arange(size)[nodes] for size in view.ids.shape)
    x, y = np.meshgrid(columns, rows)
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1).astype(float)
    return pixels, view.inverse_depth[nodes, nodes].astype(float), view.ids[nodes, nodes]


def _turn(R: Floats, X: Floats) -> Floats:
    """Rotations (..., 3, 3) times vectors (..., 3)."""
    return np.asarray((R @ X[..., None])[..., 0])
