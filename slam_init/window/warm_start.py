"""Warm start: the points of a fit are the start of the next one.

A window differs from the one before it by a frame, so the answer of its fit is near that of the last fit. A start from
measured rays and linear triangulation would need a dozen steps to come there again. The points are homogeneous, so that
points at infinity are kept too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.pose import Pose
from slam_init.window.state import WindowState
from slam_init.window.tracks import WindowTracks

#: A point at infinity is put at this many median distances where a point is needed: a baseline moves it by less than
#: a ten thousandth of the median parallax.
_FAR = 1e4


@dataclass(frozen=True, eq=False)
class WarmStart:
    """The points of the tracks of a fit."""

    #: (T,) In ascending order.
    track_ids: Ints
    #: (T, 4) Homogeneous, in the world of the motion.
    points: Floats
    #: (T,) Tracks whose point lies on the plane of the fit, and those that the fit explains.
    on_plane: Bools
    explained: Bools

    @staticmethod
    def of(tracks: WindowTracks, state: WindowState, explained: Bools) -> WarmStart:
        """The points of a state.

        Shapes: ``explained`` (T,).
        """
        used = tracks.anchor >= 0
        anchor, rays = tracks.anchor[used], state.rays[used]
        R, t, rho = state.R[anchor], state.t[anchor], state.distances_by_plane(tracks.anchor)[used]
        on_plane = state.on_plane[used] & (state.plane is not None)
        points = np.einsum("tji,tj->ti", R, rays - rho[:, None] * t)
        return WarmStart(tracks.track_ids[used], np.column_stack([points, rho]), on_plane, explained[used])

    def moved(self, new_from_old: Pose) -> WarmStart:
        """The same points in another world."""
        X, w = self.points[:, :3], self.points[:, 3]
        moved = X @ new_from_old.R.T + w[:, None] * new_from_old.t
        return replace(self, points=np.column_stack([moved, w]))

    def start(self, tracks: WindowTracks, state: WindowState) -> WindowState:
        """A state with the rays and the distances of the points that are known; the others as they are."""
        if not len(self.track_ids):
            return state
        at = np.minimum(np.searchsorted(self.track_ids, tracks.track_ids), len(self.track_ids) - 1)
        anchor = np.maximum(tracks.anchor, 0)
        X, w = self.points[at, :3], self.points[at, 3]
        v = np.einsum("tij,tj->ti", state.R[anchor], X) + w[:, None] * state.t[anchor]
        lengths = np.linalg.norm(v, axis=1)
        known = (self.track_ids[at] == tracks.track_ids) & (tracks.anchor >= 0) & (lengths > 0)
        lengths = np.where(known, lengths, 1.0)
        return replace(
            state,
            rays=np.where(known[:, None], v / lengths[:, None], state.rays),
            inverse_distances=np.where(known, w / lengths, state.inverse_distances),
            on_plane=np.where(known, self.on_plane[at], state.on_plane) & (state.plane is not None),
        )

    def of_tracks(self, track_ids: Ints) -> Floats:
        """The points of some tracks in the world.

        Shapes: ``track_ids`` (N,), returns (N, 3).

        * Returns: NaN for a track that is not known, or that the fit does not explain.
        """
        found = np.full((len(track_ids), 3), np.nan)
        if not self.explained.any():
            return found
        at = np.minimum(np.searchsorted(self.track_ids, track_ids), len(self.track_ids) - 1)
        known = (self.track_ids[at] == track_ids) & self.explained[at]
        X, w = self.points[at[known], :3], self.points[at[known], 3]
        near = np.linalg.norm(self.points[self.explained, :3], axis=1)
        distances = near / np.maximum(self.points[self.explained, 3], 1e-300)
        least = np.linalg.norm(X, axis=1) / (_FAR * float(np.median(distances)))
        found[known] = X / np.maximum(w, np.maximum(least, 1e-300))[:, None]
        return found
