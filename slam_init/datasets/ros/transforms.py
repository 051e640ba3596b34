"""The tree of coordinate frames of ``tf`` and ``tf_static``.

A transform is an edge ``parent_from_child``. Edges of ``tf_static`` do not move, nor do those of ``tf`` that are sent
again and again with one value, as ROS 1 does. The pose of a frame in the root of the tree is the product of the edges
above it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose

# Edges are interpolated over at most this time. The error is a t^2 / 8: a hand that accelerates by 5 m/s^2 moves 6 mm
# from the straight line in 0.1 s.
_LONGEST_GAP_S = 0.1
# Static transforms that are sent again are equal up to the digits of a double.
_SAME = 1e-9


@dataclass(frozen=True)
class StampedTransform:
    """A transform ``parent_from_child`` at a time."""

    time_s: float
    #: parent, child: Names of the frames.
    parent: str
    child: str
    #: (3,)
    t: Floats
    #: (4,) Unit quaternion.
    q_wxyz: Floats


@dataclass(frozen=True, eq=False)
class Edge:
    """A transform ``parent_from_child`` over time."""

    parent: str
    #: (N,) Strictly increasing; one for a transform that does not move.
    times_s: Floats
    #: (N, 3)
    t: Floats
    #: (N, 4) Unit quaternions.
    q_wxyz: Floats

    @property
    def moves(self) -> bool:
        """Whether it changes."""
        return len(self.times_s) > 1

    def at(self, times_s: Floats) -> tuple[Floats, list[Pose]]:
        """Interpolate the transform.

        Shapes: ``times_s`` (M,), returns ``known`` (M,).

        * Returns ``known``: Where there is a transform before and after, no more than 0.1 s apart, or one at the time
          itself.
        """
        from scipy.spatial.transform import Rotation, Slerp

        if not self.moves:
            return np.ones(len(times_s), bool), [Pose.from_quaternion(self.q_wxyz[0], self.t[0])] * len(times_s)
        after = np.clip(np.searchsorted(self.times_s, times_s), 1, len(self.times_s) - 1)
        inside = (times_s >= self.times_s[0]) & (times_s <= self.times_s[-1])
        near = self.times_s[after] - self.times_s[after - 1] <= _LONGEST_GAP_S
        known = inside & (near | np.isin(times_s, self.times_s))
        if not known.any():
            return known, []
        rotations = Slerp(self.times_s, Rotation.from_quat(self.q_wxyz[:, [1, 2, 3, 0]]))(times_s[known])
        positions = np.stack([np.interp(times_s[known], self.times_s, column) for column in self.t.T], axis=1)
        matrices = rotations.as_matrix()
        return known, [Pose(R, t) for R, t in zip(matrices, positions, strict=True)]


@dataclass(frozen=True, eq=False)
class TransformTree:
    """Coordinate frames and the edges between them."""

    #: By the name of the child.
    edges: dict[str, Edge] = field(default_factory=dict)

    @staticmethod
    def gather(transforms: Iterable[StampedTransform]) -> TransformTree:
        """Gather transforms.

        * ``transforms``: In any order. Of a child with several parents, the last parent is taken.
        """
        by_child: dict[str, dict[float, StampedTransform]] = {}
        for transform in transforms:
            known = by_child.setdefault(transform.child, {})
            if known and next(iter(known.values())).parent != transform.parent:
                known.clear()
            known.setdefault(transform.time_s, transform)
        return TransformTree(
            {child: _edge([known[time] for time in sorted(known)]) for child, known in by_child.items()}
        )

    def above(self, frame: str) -> list[str]:
        """List a frame and the frames above it.

        * Returns: From the frame to the root of its tree. A circle ends where it closes.
        """
        names = [frame]
        while (edge := self.edges.get(names[-1])) is not None and edge.parent not in names:
            names.append(edge.parent)
        return names

    def rigid_above(self, frame: str) -> list[str]:
        """List a frame and the frames above it that do not move against it."""
        names = self.above(frame)
        moving = [k for k, name in enumerate(names[:-1]) if self.edges[name].moves]
        return names[: moving[0] + 1] if moving else names

    def rigid(self, target: str, source: str) -> Pose | None:
        """Find the transform between two frames that do not move against each other."""
        above_target, above_source = self.rigid_above(target), self.rigid_above(source)
        common = next((name for name in above_source if name in above_target), None)
        if common is None:
            return None
        return self._still(above_target, common).inverse() @ self._still(above_source, common)

    def path_of(self, frame: str) -> tuple[str, list[tuple[float, Pose]]]:
        """Compute the motion of a frame in the root of its tree.

        The times are those of the edge that moves most often; the other edges are interpolated.
        """
        names = self.above(frame)
        edges = [self.edges[name] for name in names[:-1]]
        if not any(edge.moves for edge in edges):
            return names[-1], []
        times_s = max(edges, key=lambda edge: len(edge.times_s)).times_s
        for edge in edges:
            times_s = times_s[edge.at(times_s)[0].astype(bool)]
        poses = [Pose.identity()] * len(times_s)
        for edge in edges:
            poses = [above @ below for above, below in zip(edge.at(times_s)[1], poses, strict=True)]
        return names[-1], list(zip(times_s.tolist(), poses, strict=True))

    def _still(self, names: list[str], last: str) -> Pose:
        """The transform ``last_from_first`` along edges that do not move."""
        pose = Pose.identity()
        for name in names[: names.index(last)]:
            edge = self.edges[name]
            pose = Pose.from_quaternion(edge.q_wxyz[0], edge.t[0]) @ pose
        return pose


def _edge(transforms: list[StampedTransform]) -> Edge:
    """The edge of the transforms of one child, which are sorted by time."""
    t = np.array([transform.t for transform in transforms])
    q = np.array([transform.q_wxyz for transform in transforms])
    if np.ptp(t, axis=0).max() < _SAME and np.ptp(q, axis=0).max() < _SAME:
        transforms, t, q = transforms[:1], t[:1], q[:1]
    return Edge(transforms[0].parent, np.array([transform.time_s for transform in transforms]), t, q)
