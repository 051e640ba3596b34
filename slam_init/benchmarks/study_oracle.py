"""What the tracks of a world could tell: least squares from the truth, on the right tracks alone.

No method can know which tracks are right, nor begin at the truth; where this fails the information is not there. On a
plane it stays with the truth; the vote between the two motions needs more than that.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from slam_init.benchmarks.map_quality import adjusted_by_pycolmap, errors_of, opened_points
from slam_init.bundle.problem import BundleProblem
from slam_init.compare.measures import PoseErrors, is_correct
from slam_init.compare.sources import Judging
from slam_init.datasets.points import PointSource

__all__ = ["solvable_worlds", "true_problem"]

#: As many as our maps have at most.
_VIEWS = 6


def solvable_worlds(texts: Iterable[str]) -> set[str]:
    """Those sources from which least squares finds a correct map."""
    found = set()
    for text in texts:
        source = opened_points(text)
        start = true_problem(source)
        errors = errors_of(source, adjusted_by_pycolmap(source.camera, start, robust=False), start.track_ids)
        if is_correct(PoseErrors(errors.rotation_deg, errors.direction_deg), Judging()):
            found.add(text)
    return found


def true_problem(source: PointSource) -> BundleProblem:
    """The true poses and points, with the measured pixels, of views spread over the sequence; right tracks only."""
    sequence, truth = source.sequence, source.groundtruth.world_from_cam
    frames = tuple(int(frame) for frame in np.linspace(0, len(sequence) - 1, _VIEWS).round())
    first_from_world = truth[0].inverse()
    right = ~(sequence.wrong | sequence.moving)
    seen = sequence.visible[list(frames)] & right
    seen &= seen.sum(axis=0) >= 2
    track_ids = np.flatnonzero(seen.any(axis=0))
    views, landmarks = np.nonzero(seen[:, track_ids])
    return BundleProblem(
        frames=frames,
        world_from_cam=tuple(first_from_world @ truth[frame] for frame in frames),
        points=first_from_world.apply(sequence.points[track_ids]),
        track_ids=track_ids,
        views=views.astype(np.int64),
        landmarks=landmarks.astype(np.int64),
        pixels=sequence.pixels[np.array(frames)[views], track_ids[landmarks]],
    )
