"""Tracks without images: points of a known scene seen by a moving camera, thousands of sequences per minute.

The scenes have the names of the rendered ones, and depth, planes and motion of the same kind, drawn from a seed. Tracks
have Gaussian noise. Some tracks are outliers, and on request some lie on bodies that move on their own. On request the
tracks of a view also have a smooth error in common (:mod:`sequences_synth.tracking_error`), and the camera has a
rolling shutter (:mod:`sequences_synth.camera`) or a wrong calibration. Poses are ``world_from_cam`` of the middle row.
The world frame is the pose at which the camera would start without the tremor of the hand; in the scenes ``handheld``
and ``handheld-wall`` it is the pose about which the hand turns the camera. The length of the path is given relative to
the median depth of the scene ::

    sequence = make_points("wall", seed=3, options=PointOptions(noise_px=1.0))
    track_ids, pixels = sequence.observe(5)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Bools, Floats, Ints
from sequences_synth.camera import SynthCamera, stated_camera
from sequences_synth.options import PointOptions, check_scene, stream
from sequences_synth.point_scenes import LAYOUTS
from sequences_synth.point_world import MOVING, OUTLIER, Shot, film, inside
from sequences_synth.tracking_error import TrackingError

#: Names of the scenes.
POINT_SCENES: tuple[str, ...] = tuple(LAYOUTS)

# A horizontal field of view of 70 degrees at 640x480: an ordinary wide lens.
_WIDTH, _HEIGHT, _FOCAL_PX = 640, 480, 458.0


@dataclass(frozen=True, eq=False)
class PointSequence:
    """A sequence of tracks with exact truth."""

    name: str
    options: PointOptions
    #: The stated camera, which has the errors of the options and no distortion.
    camera: SynthCamera
    #: (V, 4, 4) World_from_cam of the middle row.
    poses: Floats
    #: (V,) Time of the middle row.
    timestamps_s: Floats
    #: (M, 3) In the world frame, at the first view. Those on moving objects change their place later.
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
    #: The true camera, path, shutter and bodies.
    shot: Shot

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

        * Returns: Depth along the optical axis; NaN for outliers and for tracks on moving objects.
        """
        cam_from_world = np.linalg.inv(self.poses[index])
        z = self.points @ cam_from_world[2, :3] + cam_from_world[2, 3]
        return np.asarray(np.where(self.is_outlier | self.is_moving, np.nan, z))


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
    pinhole = SynthCamera(_WIDTH, _HEIGHT, _FOCAL_PX, _FOCAL_PX, *centre)
    error_rng = stream(seed, b"tracking error ", name)
    error = TrackingError.draw(error_rng, options.views, _WIDTH, _HEIGHT, options.field_px, options.drift_px)
    rng, body_rng, camera_rng = (stream(seed, purpose, name) for purpose in (b"", b"bodies ", b"principal point "))
    shot, kinds = film(name, pinhole.bent(options.k1), options.views, options, rng, body_rng)
    pixels, visible = _measure(shot, kinds, error, options, rng)
    return PointSequence(
        name=name,
        options=options,
        camera=stated_camera(pinhole, options.focal_error, options.principal_error, camera_rng),
        poses=np.stack([shot.path.at_frame(view) for view in range(options.views)]),
        timestamps_s=np.asarray(1 / options.fps * np.arange(options.views), float),
        points=shot.points,
        is_outlier=kinds == OUTLIER,
        is_moving=kinds == MOVING,
        pixels=pixels,
        visible=visible,
        tracking_error=error,
        shot=shot,
    )


def _measure(
    shot: Shot, kinds: Ints, error: TrackingError, options: PointOptions, rng: np.random.Generator
) -> tuple[Floats, Bools]:
    """Measured pixels (V, M, 2), and which tracks each view sees (V, M)."""
    size = np.array([shot.camera.width, shot.camera.height], float)
    pixels = np.empty((options.views, len(kinds), 2))
    visible = np.empty(pixels.shape[:2], bool)
    for view in range(options.views):
        true, seen = shot.see(view)
        measured = true + options.noise_px * rng.normal(size=true.shape) + error.at(view, true)
        anywhere = rng.uniform(0, size - 1, measured.shape)
        pixels[view] = np.where((kinds == OUTLIER)[:, None], anywhere, measured)
        visible[view] = seen & inside(shot.camera, pixels[view])
    return pixels, visible
