"""Which worlds are solvable: least squares from the true poses and points, with the inlier tracks only.

A method knows neither the inliers nor the truth. If least squares fails even with this knowledge, the tracks do not
contain enough information. On a plane least squares stays at the true motion; a method must also choose between the two
motions of the plane, which needs more information.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from slam_init.bundle.problem import BundleProblem
from slam_init.compare.judging import Criteria
from slam_init.compare.measures import PoseErrors, is_correct
from slam_init.datasets.points import PointSource
from tests.benchmarks.map_quality import adjusted_by_pycolmap, errors_of, opened_points

#: Largest number of keyframes of a map of slam_init.
_VIEWS = 6


def solvable_worlds(texts: Iterable[str]) -> set[str]:
    """Return the sources for which least squares finds a correct map."""
    found = set()
    for text in texts:
        source = opened_points(text)
        start = true_problem(source)
        errors = errors_of(source, adjusted_by_pycolmap(source.camera, start, robust=False), start.track_ids)
        if is_correct(PoseErrors(errors.rotation_deg, errors.direction_deg), Criteria()):
            found.add(text)
    return found


def true_problem(source: PointSource) -> BundleProblem:
    """Return the true poses and points with the measured pixels of the inliers, for views spread over the sequence."""
    sequence, truth = source.sequence, source.groundtruth.world_from_cam
    frames = tuple(int(frame) for frame in np.linspace(0, len(sequence) - 1, _VIEWS).round())
    first_from_world = truth[0].inverse()
    inlier = ~(sequence.is_outlier | sequence.is_moving)
    seen = sequence.visible[list(frames)] & inlier
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
