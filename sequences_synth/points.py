"""Tracks without images: points of a known scene seen by a moving camera, thousands of sequences per minute.

The scenes have the names of the rendered ones, and depth, planes and motion of the same kind, by a seed. Tracks
have Gaussian noise. Some tracks are outliers, and on request some lie on moving objects. On request the
tracks of a view also have a smooth error in common (:class:`TrackingError`), and the camera has a
rolling shutter (:mod:`sequences_synth.camera`) or a wrong calibration. Poses are ``world_from_cam`` of the middle row.
The world frame is the pose at which the camera would start without the tremor of the hand; in the scenes ``handheld``
and ``handheld-wall`` it is the pose about which the hand turns the camera. The length of the path is given relative to
the median depth of the scene ::

    sequence = make_points("wall", seed=3, options=PointOptions(noise_px=1.0))
    pixels = sequence.pixels[5, sequence.visible[5]]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences_synth.arrays import Bools, Floats, Ints
from sequences_synth.camera import SynthCamera, stated_camera
from sequences_synth.options import PointOptions, check_scene, stream
from sequences_synth.point_scenes import LAYOUTS
from sequences_synth.point_world import MOVING, OUTLIER, Shot, film, inside

# -- correlated tracking error ---------------------------------------------------------------------


# The correlated error of a view is a smooth field of pixel errors that all its tracks share. It is a polynomial
# of the image coordinates with constant, linear and quadratic terms, one for each pixel coordinate. The polynomials of
# `_basis` are orthonormal over the image. So the mean square of the field over the image is the sum of its squared
# coefficients.

# Number of polynomials of degree 2 or less in two variables.
_TERMS = 6


@dataclass(frozen=True, eq=False)
class TrackingError:
    """The smooth correlated error of each view.

    Attributes
    ----------
    width, height : int
        Image size in pixels.
    coefficients_px : (V, 2, 6) float
        Coefficients by view, pixel coordinate (x, y) and polynomial. The polynomials are orthonormal over the image, in
        the order 1, x, y, x^2, x y, y^2 of their leading terms.
    """

    width: int
    height: int
    coefficients_px: Floats

    @staticmethod
    def draw(
        rng: np.random.Generator, views: int, width: int, height: int, correlated_px: float, drift_px: float
    ) -> TrackingError:
        """Draw the sum of a field that is independent in each view and of a field that drifts from view to view.

        Parameters
        ----------
        rng : numpy.random.Generator
            The number of draws depends on ``views`` only.
        views : int
            At least 2.
        width, height : int
            Image size in pixels.
        correlated_px : float
            Root mean square of one coordinate over the image, for the independent field of each view.
        drift_px : float
            The same for the drift in the last view. The drift is zero in the first view, and its coefficients perform a
            random walk.

        Returns
        -------
        TrackingError
        """
        field = rng.normal(size=(views, 2, _TERMS))
        field *= correlated_px / _rms(field)
        walk = np.zeros((views, 2, _TERMS))
        walk[1:] = np.cumsum(rng.normal(size=(views - 1, 2, _TERMS)), axis=0)
        walk *= drift_px / _rms(walk[-1])
        return TrackingError(width, height, field + walk)

    def at(self, index: int, pixels: Floats) -> Floats:
        """Compute the correlated tracking error of one view.

        Parameters
        ----------
        index : int
            Position of the view, from 0.
        pixels : (N, 2) float
            True pixels.

        Returns
        -------
        (N, 2) float
            Measured minus true pixels.
        """
        centre = 0.5 * (np.array([self.width, self.height]) - 1)
        return np.asarray(_basis((pixels - centre) / centre) @ self.coefficients_px[index].T)


def _basis(where: Floats) -> Floats:
    """(N, 6) products of Legendre polynomials; ``where`` (N, 2) runs from -1 to 1 over the image.

    Any two of them have a mean product of 0 over the image, and each has a mean square of 1.
    """
    x, y = where.T
    linear_x, linear_y = np.sqrt(3) * x, np.sqrt(3) * y
    quadratic_x, quadratic_y = np.sqrt(5) / 2 * (3 * x**2 - 1), np.sqrt(5) / 2 * (3 * y**2 - 1)
    return np.column_stack([np.ones(len(where)), linear_x, linear_y, quadratic_x, linear_x * linear_y, quadratic_y])


def _rms(coefficients: Floats) -> Floats:
    """Root mean square (..., 1, 1) of one coordinate over the image, of fields with the coefficients (..., 2, 6)."""
    return np.asarray(np.sqrt(np.sum(coefficients**2, axis=(-2, -1), keepdims=True) / 2))


# -- the sequence ----------------------------------------------------------------------------------


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
    #: The true camera, path, shutter and moving objects.
    shot: Shot

    def __len__(self) -> int:
        return len(self.poses)

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
    error = TrackingError.draw(error_rng, options.views, _WIDTH, _HEIGHT, options.correlated_px, options.drift_px)
    rng, object_rng, camera_rng = (stream(seed, purpose, name) for purpose in (b"", b"bodies ", b"principal point "))
    shot, kinds = film(name, pinhole.bent(options.k1), options, rng, object_rng)
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
