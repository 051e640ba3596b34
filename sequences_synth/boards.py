"""Bodies that move and turn in front of the camera: textured boards that fill a stated share of its view.

The boards follow the gaze of the camera, as a person does whom the camera follows, so that their share of the view is
the same in every frame. In the frame of the camera they sway and oscillate about their own vertical axes. A pair of
views in which most tracks lie on one board therefore shows the rigid motion of this board.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sequences_synth.builder import Setup
from sequences_synth.textured_quad import Quad
from sequences_synth.trajectory import rotation_from_vector

Floats = NDArray[np.float64]

# Amplitude of the turning, radians: at more than 40 degrees a board would hide itself.
_TURN_RAD = np.radians(35.0)
# Mean of cos(_TURN_RAD sin x) over x: a board that turns looks narrower on average by this factor.
_NARROWER = 0.909
# Sway of a board, share of the gap between it and the border of its part of the view, and its largest value in shares
# of the view.
_SWAY, _LARGEST_SWAY = 0.8, 0.1
# Hertz of the sway: as of a person who moves about.
_SWAY_HZ = (0.25, 0.5)
# Nearest distance over that of the scene: the boards never intersect the scene.
_NEARER = 0.55
# Frames at which the distance of the scene is measured.
_FRAMES = np.linspace(0, 600, 41)


@dataclass(frozen=True, eq=False)
class _BoardMotion:
    """The motion of a board in the frame of the camera, with the path of the camera itself."""

    world_from_cam: Callable[[float], Floats]
    fps: float
    place: Floats  # (3,) in the frame of the camera, metres
    sway: Floats  # (3,) metres
    rates_rad_s: Floats  # (3,)
    phases_rad: Floats  # (3,)
    turn_rad: float
    turn_rate_rad_s: float
    turn_phase_rad: float

    def __call__(self, frame: float) -> Floats:
        time_s = frame / self.fps
        pose = np.eye(4)
        angle = self.turn_rad * np.sin(self.turn_phase_rad + self.turn_rate_rad_s * time_s)
        pose[:3, :3] = rotation_from_vector(np.array([0.0, angle, 0.0]))
        pose[:3, 3] = self.place + self.sway * np.sin(self.phases_rad + self.rates_rad_s * time_s)
        return np.asarray(self.world_from_cam(frame) @ pose)


def moving_boards(
    setup: Setup,
    rng: np.random.Generator,
    world_from_cam: Callable[[float], Floats],
    quads: list[Quad],
    share: float,
    count: int,
    turn_deg_s: float,
) -> list[Quad]:
    """Make boards side by side that together cover a share of the view."""
    nearest = min(nearest_ahead(setup, quads, world_from_cam(float(frame))) for frame in _FRAMES)
    depth = _NEARER * nearest
    view = depth * np.array([setup.width / setup.K[0, 0], setup.height / setup.K[1, 1]])
    cell = view / [count, 1]
    side = np.sqrt(share) * cell
    if turn_deg_s > 0:
        side[0] = min(side[0] / _NARROWER, 0.98 * cell[0])
    painter = setup.painter(np.zeros(3), depth)
    painter.count = len(quads)
    boards = []
    for i in range(count):
        place = np.array([(i + 0.5) * cell[0] - 0.5 * view[0], 0.0, depth])
        sway = np.minimum(0.5 * _SWAY * (cell - side), _LARGEST_SWAY * view)
        motion = _BoardMotion(
            world_from_cam=world_from_cam,
            fps=setup.fps,
            place=place,
            # Towards the camera and back as well, by a tenth of the distance.
            sway=np.array([*sway, 0.05 * depth]),
            rates_rad_s=2 * np.pi * rng.uniform(*_SWAY_HZ, 3),
            phases_rad=rng.uniform(0, 2 * np.pi, 3),
            turn_rad=_TURN_RAD if turn_deg_s > 0 else 0.0,
            # The root mean square of the speed of A sin(w t) is A w / sqrt(2).
            turn_rate_rad_s=np.sqrt(2) * np.radians(turn_deg_s) / _TURN_RAD,
            turn_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        )
        corner = np.array([-0.5 * side[0], -0.5 * side[1], 0.0])
        edges = np.array([side[0], 0.0, 0.0]), np.array([0.0, side[1], 0.0])
        painted = painter.quad(corner + np.array([0.0, 0.0, depth]), *edges, "print")
        boards.append(replace(painted, corner=corner, body=motion))
    return boards


def nearest_ahead(setup: Setup, quads: Sequence[Quad], pose: Floats) -> float:
    """Compute the least depth of the scene along 7x7 rays spread over the view.

    Shapes: ``pose`` (4, 4).
    """
    x, y = np.meshgrid(np.linspace(0, setup.width - 1, 7), np.linspace(0, setup.height - 1, 7))
    rays = pose[:3, :3] @ np.linalg.inv(setup.K) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    depths = []
    for quad in quads:
        edges = np.column_stack([quad.edge_u, quad.edge_v])
        normal = np.cross(*edges.T)
        depth = (normal @ (quad.corner - pose[:3, 3])) / (normal @ rays)
        a, b = np.linalg.pinv(edges) @ (pose[:3, 3:] + depth * rays - quad.corner[:, None])
        depths.append(depth[(depth > 0) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)])
    return float(np.concatenate(depths).min())
