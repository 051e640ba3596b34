"""The options of a sequence of tracks without images."""

from __future__ import annotations

from dataclasses import dataclass

from sequences_synth.limits import EFFECT_LIMITS, check_options

_LIMITS = EFFECT_LIMITS | {
    "views": (2, 10_000), "points": (1, 100_000), "noise_px": (0, 100), "outliers": (0, 1), "moving": (0, 1),
    "baseline": (0, 10), "field_px": (0, 100), "drift_px": (0, 100), "bodies": (1, 100), "cut": (0, 10_000),
}  # fmt: skip


@dataclass(frozen=True)
class PointOptions:
    """Options of a sequence; the same for every scene.

    Attributes
    ----------
    views : int
        Number of frames.
    points : int
        Approximate number of tracks in a view.
    noise_px : float
        Standard deviation of one coordinate of a pixel.
    outliers : float
        Share of the tracks that are outliers: in each view at a random place in the image.
    moving : float
        Share of the tracks on bodies that move on their own.
    baseline : float
        Distance of the camera from first to last view over the median depth. Where the camera does not translate, and
        in ``handheld`` and ``handheld-wall``, it is only the scale of the motion of bodies.
    focal_error : float
        The stated focal length is the true one times ``1 + focal_error``.
    field_px : float
        Root mean square over the image of one coordinate of the correlated tracking error: a smooth field that the
        tracks of a view have in common. The field of each view is independent of the others. Outliers do not have it.
    drift_px : float
        The same for a smooth field that performs a random walk over the views: 0 in the first view, and ``drift_px`` in
        the last one.
    fps : float
        Frames per second. In the scenes ``handheld``, ``handheld-wall`` and ``pan`` it decides how far the camera turns
        from view to view. The path of the other scenes does not depend on it.
    readout_ms : float
        Readout time of the rolling shutter, at most a frame interval; 0 for a global shutter. See
        :mod:`sequences_synth.shutter`.
    readout_direction : str
        Order in which rows or columns are read: ``down``, ``up``, ``right`` or ``left``.
    exposure_ms : float
        Exposure time, at most a frame interval. The standard deviation of a track along its motion in the image is
        ``hypot(noise_px, 0.1 * motion during the exposure)``; across its motion it is ``noise_px``.
    turning_deg_s : float
        Root mean square of the angular speed in the scenes ``handheld`` and ``handheld-wall``, and speed of the scene
        ``pan``. The other scenes ignore it.
    speed : float
        Speed of the translation in the scenes ``handheld`` and ``handheld-wall``, median depths per second. The other
        scenes ignore it.
    bodies : int
        Number of moving objects among which the moving tracks are divided.
    body_turn_deg_s : float
        Angular speed of each body about its own centre; the axes are drawn.
    principal_error : float
        Error of the stated principal point: horizontally over the width, vertically over the height. The signs are
        drawn.
    k1 : float
        Coefficient of radial distortion of the true camera, which the stated camera lacks.
    stabilized : bool
        Whether each frame is warped to a smoothed path, see :mod:`sequences_synth.stabilizer`. The true poses are then
        those of the virtual camera.
    dropped : float
        Share of the frames that are missing. The frames that are left are ``views``, and their time stamps jump.
    repeated : float
        Share of the frames that repeat the frame before, with a new time stamp. The true pose of such a frame is that
        of the frame that it repeats.
    cut : int
        Position of the view at which another scene of the same kind begins, at least 2; 0 for none. All tracks are
        then new. The poses of the second scene have the world frame of the second scene: they have no relation to those
        before.

    Raises
    ------
    ValueError
        If an option is out of range; the message names the option.
    """

    views: int = 12
    points: int = 300
    noise_px: float = 0.7
    outliers: float = 0.1
    moving: float = 0.0
    baseline: float = 0.15
    focal_error: float = 0.0
    field_px: float = 0.0
    drift_px: float = 0.0
    fps: float = 10.0
    readout_ms: float = 0.0
    readout_direction: str = "down"
    exposure_ms: float = 0.0
    turning_deg_s: float = 60.0
    speed: float = 0.0
    bodies: int = 2
    body_turn_deg_s: float = 0.0
    principal_error: float = 0.0
    k1: float = 0.0
    stabilized: bool = False
    dropped: float = 0.0
    repeated: float = 0.0
    cut: int = 0

    def __post_init__(self) -> None:
        check_options(self, _LIMITS)
        if self.outliers + self.moving > 1:
            raise ValueError(f"outliers and moving are {self.outliers} and {self.moving}: together at most 1")
        if self.cut and not 2 <= self.cut <= self.views - 2:
            raise ValueError(f"cut is {self.cut}: each scene needs 2 of the {self.views} views")
