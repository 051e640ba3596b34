"""Tracks without images: points of a known scene seen by a moving camera, thousands of sequences per minute.

The scenes have the names of the rendered ones, and depth, planes and motion of the same kind, drawn from a seed. Tracks
have Gaussian noise. Some tracks are outliers, and on request some lie on bodies that move on their own. On request the
tracks of a view also have a smooth error in common (:mod:`sequences_synth.tracking_error`), and the camera has a
rolling shutter (:mod:`sequences_synth.shutter`), a long exposure, wrong calibration, or electronic stabilization
(:mod:`sequences_synth.stabilizer`). Frames may be dropped or repeated, and a cut may lead to another scene. Poses are
``world_from_cam`` of the middle row. The world frame is the pose at which the camera would start without the tremor of
the hand; in the scenes ``handheld`` and ``handheld-wall`` it is the pose about which the hand turns the camera. The
length of the path is given relative to the median depth of the scene ::

    sequence = make_points("wall", seed=3, options=PointOptions(noise_px=1.0))
    track_ids, pixels = sequence.observe(5)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sequences_synth.arrays import Bools, Floats, Ints
from sequences_synth.camera import PinholeCamera, stated_camera
from sequences_synth.options import PointOptions, check_scene
from sequences_synth.point_scenes import HAND_LAYOUTS, LAYOUTS
from sequences_synth.point_shot import Shot
from sequences_synth.point_world import MOVING, OUTLIER, film
from sequences_synth.schedule import Schedule, stream
from sequences_synth.tracking_error import TrackingError

#: Names of the scenes.
POINT_SCENES: tuple[str, ...] = (*LAYOUTS, *HAND_LAYOUTS)
#: Scenes in which the camera never translates. In the scenes ``handheld`` and ``handheld-wall`` the camera does not
#: translate either if the option ``speed`` is 0.
SCENES_WITHOUT_TRANSLATION: tuple[str, ...] = ("rotation", "static", "pan")

# A horizontal field of view of 70 degrees at 640x480: an ordinary wide lens.
_WIDTH, _HEIGHT, _FOCAL_PX = 640, 480, 458.0
# Standard deviation of a track along the blur of a long exposure, over the length of the blur. In rendered frames of
# the scenes `handheld` and `pan` (80 deg/s, exposures of 10 to 30 ms) Lucas-Kanade tracks err along the blur by
# 0.015 of its length from one frame to the next. Such errors add up: to 0.1 over 45 frames. The error here is
# independent in each view, and has this size from the first view on; a tracker has less on its first frames.
_BLUR = 0.1


@dataclass(frozen=True, eq=False)
class PointSequence:
    """A sequence of tracks with exact truth."""

    name: str
    seed: int
    options: PointOptions
    #: The stated camera, which has the errors of the options and no distortion.
    camera: PinholeCamera
    #: The camera by which the points were projected.
    true_camera: PinholeCamera
    #: (V, 4, 4) World_from_cam of the middle row. After a cut the world is another one.
    poses: Floats
    #: (V,) Time of the middle row.
    timestamps_s: Floats
    #: (M, 3) In the world frame of their scene, at its first view. Those on moving objects change their place later.
    points: Floats
    #: (M,) Tracks that are outliers.
    is_outlier: Bools
    #: (M,) Tracks on moving objects.
    is_moving: Bools
    #: (V, M, 2) Measured pixels, with noise and correlated error.
    pixels: Floats
    #: (V, M) Whether a view sees a track.
    visible: Bools
    #: The correlated error that ``pixels`` contain, except those of outliers.
    tracking_error: TrackingError
    #: (M,) Number of the body of a moving track, -1 for other tracks.
    body_of_track: Ints
    #: (M,) 0 for tracks before the cut, 1 for tracks after it.
    scene_of_track: Ints
    #: Dropped and repeated frames, and the cut.
    schedule: Schedule
    #: The true camera, path, shutter and bodies of each scene.
    shots: tuple[Shot, ...]

    def __len__(self) -> int:
        return len(self.poses)

    def observe(self, index: int) -> tuple[Ints, Floats]:
        """Read the tracks that one view sees.

        Shapes: returns ``track_ids`` (N,), returns ``pixels`` (N, 2).
        """
        ids = np.flatnonzero(self.visible[index])
        return ids.astype(np.int64), self.pixels[index, ids]

    def depths(self, index: int) -> Floats:
        """Compute the true depth of each track in one view.

        Shapes: returns (M,).

        * Returns: Depth along the optical axis; NaN for outliers, for tracks on moving objects and for those of another
          scene.
        """
        cam_from_world = np.linalg.inv(self.poses[index])
        z = self.points @ cam_from_world[2, :3] + cam_from_world[2, 3]
        elsewhere = self.scene_of_track != self.schedule.shown(index)[0]
        return np.asarray(np.where(self.is_outlier | self.is_moving | elsewhere, np.nan, z))

    def pixel_poses(self, index: int, pixels: Floats) -> Floats:
        """Compute the poses that the camera had when it exposed pixels of one view.

        Shapes: ``pixels`` (N, 2), returns (N, 4, 4).

        * Returns: Poses world_from_cam, of the virtual camera in a stabilized view. With a global shutter all are the
          pose of the view.
        """
        scene, tick = self.schedule.shown(index)
        return self.shots[scene].pixel_poses(tick, pixels)


def make_points(name: str, seed: int = 0, options: PointOptions | None = None) -> PointSequence:
    """Make a sequence of tracks.

    Parameters
    ----------
    name : str
        One of :data:`POINT_SCENES`.
    seed : int
        Changes geometry, path, noise and outliers; not negative.
    options : PointOptions, optional

    Returns
    -------
    PointSequence

    Raises
    ------
    ValueError
        If the scene is unknown (the message lists the known ones), or if the seed is negative.
    """
    check_scene(name, seed, POINT_SCENES)
    options = options or PointOptions()
    centre = (_WIDTH - 1) / 2, (_HEIGHT - 1) / 2
    true_camera = PinholeCamera(_WIDTH, _HEIGHT, _FOCAL_PX, _FOCAL_PX, *centre, k1=options.k1)
    error = TrackingError.draw(
        stream(seed, b"tracking error ", name), options.views, _WIDTH, _HEIGHT, options.field_px, options.drift_px
    )
    schedule = Schedule.draw(stream(seed, b"schedule ", name), options.views, options)
    scenes = []
    for number, frames in enumerate(schedule.scenes):
        rng, body_rng, blur_rng = (
            stream(seed, number * b"after the cut " + purpose, name) for purpose in (b"", b"bodies ", b"blur ")
        )
        ticks = schedule.ticks[frames] - schedule.ticks[frames.start]
        shot, kinds = film(name, true_camera, ticks, options, rng, body_rng)
        pixels, visible = _measure(shot, kinds, ticks, frames.start, error, options, rng, blur_rng)
        scenes.append(_Scene(shot, kinds, np.stack([shot.pose(int(tick)) for tick in ticks]), pixels, visible))
    counts = [len(scene.kinds) for scene in scenes]
    kinds, content = np.concatenate([scene.kinds for scene in scenes]), schedule.content
    return PointSequence(
        name=name,
        seed=seed,
        options=options,
        camera=stated_camera(
            true_camera, options.focal_error, options.principal_error, stream(seed, b"principal point ", name)
        ),
        true_camera=true_camera,
        poses=np.concatenate([scene.poses for scene in scenes])[content],
        timestamps_s=np.asarray(1 / options.fps * schedule.ticks, float),
        points=np.concatenate([scene.shot.points for scene in scenes]),
        is_outlier=kinds == OUTLIER,
        is_moving=kinds == MOVING,
        pixels=_block_diagonal([scene.pixels for scene in scenes], np.nan)[content],
        visible=_block_diagonal([scene.visible for scene in scenes], False)[content],
        tracking_error=replace(error, coefficients_px=error.coefficients_px[content]),
        body_of_track=np.concatenate([scene.shot.bodies.body_of_track for scene in scenes]),
        scene_of_track=np.repeat(np.arange(len(counts)), counts),
        schedule=schedule,
        shots=tuple(scene.shot for scene in scenes),
    )


@dataclass(frozen=True, eq=False)
class _Scene:
    """The tracks of one scene: kinds (M,), true poses (V, 4, 4), measured pixels (V, M, 2), visible (V, M)."""

    shot: Shot
    kinds: Ints
    poses: Floats
    pixels: Floats
    visible: Bools


def _block_diagonal(blocks: list[NDArray[Any]], fill: float | bool) -> NDArray[Any]:
    """Blocks (V_k, M_k, ...) as one array (sum of V_k, sum of M_k, ...)."""
    if len(blocks) == 1:
        return blocks[0]
    rows, columns = (sum(block.shape[axis] for block in blocks) for axis in (0, 1))
    whole = np.full((rows, columns, *blocks[0].shape[2:]), fill, blocks[0].dtype)
    row = column = 0
    for block in blocks:
        whole[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return whole


def _measure(
    shot: Shot,
    kinds: Ints,
    ticks: Ints,
    first_view: int,
    error: TrackingError,
    options: PointOptions,
    rng: np.random.Generator,
    blur_rng: np.random.Generator,
) -> tuple[Floats, Bools]:
    """Measured pixels (V, M, 2), and which tracks each view sees (V, M)."""
    size = np.array([shot.camera.width, shot.camera.height], float)
    pixels = np.empty((len(ticks), len(kinds), 2))
    visible = np.empty(pixels.shape[:2], bool)
    for view, tick in enumerate(ticks.tolist()):
        truth = shot.see(tick)
        true = truth.pixels
        measured = true + options.noise_px * rng.normal(size=true.shape) + error.at(first_view + view, true)
        if options.exposure_ms > 0:
            # Across the motion the noise is that of a sharp image. The normal draw along the motion is a scalar.
            measured = measured + _BLUR * truth.smear_px * blur_rng.normal(size=(len(true), 1))
        anywhere = rng.uniform(0, size - 1, measured.shape)
        pixels[view] = np.where((kinds == OUTLIER)[:, None], anywhere, measured)
        inside = ((pixels[view] >= 0) & (pixels[view] <= size - 1)).all(axis=1)
        visible[view] = truth.visible & inside
    return pixels, visible
