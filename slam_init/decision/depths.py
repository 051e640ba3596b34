"""Gates on the depths of a map: a tracker goes on from landmarks whose depths it knows.

A map may have right poses and landmarks without depths: where the camera moves toward what it looks at, or moves by
little. Three figures decide whether a tracker can go on.

* **The relative standard deviation s of a depth.** Where the next view sees a landmark displaced by p pixels through
  the translation, its prediction is off by s p. With s = 0.2 and p = 50, the parallax of a new keyframe in an image of
  800 pixels, it is off by 10: so far reaches a search window of 21 pixels. A tracker also takes the error of a
  point for a Gaussian. The distance is d / (1 + e) for an error e of the inverse distance, so that the term that is
  left out is s of the one that is kept: a fifth.
* **The share of the landmarks whose depths are known so well.** Near landmarks have known depths, and leave the view
  first. From one frame of a video to the next, up to half of the tracks end (``tracking.flow_survival``). If all of
  these have known depths, a share of three quarters leaves half of the rest, and a robust resection needs as many.
* **The next view, located by these landmarks.** It stands beside the newest keyframe, as far as the longest baseline of
  the map. How well they locate it is the measure of their spread: landmarks in a corner, or in one distance, leave
  turning and moving alike. A pan takes a half of them away, so any half (left, right, upper, lower) has to locate the
  view. Its position gives the next baseline, and an error of this baseline is one of all depths by it: the bound
  is that of a depth.

The deviations here are those of the noise of single tracks. What the tracks share (the lens, smooth errors of a view)
is in the covariances that are exported, and not here: the next view has the same lens, and neighbours err alike, so
that a prediction by landmarks is off by less. With it in the gates, a camera that moves straight ahead had no map in 20
frames where it has one now.
"""

from __future__ import annotations

import math

import numpy as np

from slam_init.bundle.problem import BundleSolution
from slam_init.config import AcceptanceConfig
from slam_init.types.arrays import Floats
from slam_init.types.refusal import Gate, GateName, Verdict, at_least, at_most

#: Least share of the landmarks with known depths, and the largest standard deviation of the position of the next view,
#: over its baseline; see the module docstring.
#: Class: geometry.
KNOWN_SHARE, MAX_LOCATED_SIGMA = 0.75, 0.2
#: A camera moves toward what it looks at where its path and the mean direction of the landmarks differ by less than
#: this angle (its cosine): then less than half of a step is sideways.
#: Class: geometry, as a cosine.
_AHEAD = math.cos(math.radians(30))


def depth_gates(bundle: BundleSolution, config: AcceptanceConfig) -> tuple[Gate, ...]:
    """Make the gates on the depths of an adjusted map.

    * ``config``: ``max_depth_sigma`` is the standard deviation of a known depth; ``min_parallax_deg`` adds a gate.
    """
    problem = bundle.problem
    newest = problem.world_from_cam[-1]
    seen = newest.inverse().apply(problem.points)
    steps = (newest.t - np.array([pose.t for pose in problem.world_from_cam])) @ newest.R
    step = steps[int(np.argmax(np.linalg.norm(steps, axis=1)))]
    known = bundle.seen_depth_sigmas <= config.max_depth_sigma
    share = float(known.sum()) / max(len(known) + bundle.unknown_depths, 1)
    noise_rad = bundle.noise_px / bundle.camera.focal_px
    sigma = located_sigma(seen[known], bundle.seen_covariances[known], float(np.linalg.norm(step)), noise_rad)
    advice, low = _advice(seen, step), Verdict.LOW_PARALLAX
    gates = [
        at_least(GateName.KNOWN_DEPTHS, share, KNOWN_SHARE, low, advice),
        at_most(GateName.LOCATED_SIGMA, sigma, MAX_LOCATED_SIGMA, low, advice),
    ]
    if config.min_parallax_deg > 0:
        parallax_deg = float(np.degrees(np.median(problem.parallax_rad())))
        gates.append(at_least(GateName.PARALLAX_DEG, parallax_deg, config.min_parallax_deg, low, advice))
    return tuple(gates)


def located_sigma(points: Floats, covariances: Floats, step: float, noise_rad: float) -> float:
    """Standard deviation of the position of a view beside the newest one, located by half of the landmarks.

    The errors of the landmarks count as independent.

    Shapes: ``points`` (L, 3), ``covariances`` (L, 3, 3).

    * Returns: Over the step, in the direction, for the view and for the half of the landmarks where it is largest.
      Infinity where the landmarks of a half do not determine the view.
    """
    places = np.arctan2(points[:, :2], points[:, 2:])
    before = places < (np.median(places, axis=0) if len(places) else 0.0)
    halves = [*before.T, *~before.T]
    views = [_information(points - step * axis, covariances, noise_rad) for axis in np.eye(3)[:2]]
    return max(_position_sigma(view[half].sum(axis=0)) for view in views for half in halves) / max(step, 1e-300)


def _information(points: Floats, covariances: Floats, noise_rad: float) -> Floats:
    """Information (L, 6, 6) of landmarks about the turn and the shift of a camera in which they lie at some points."""
    distances = np.maximum(np.linalg.norm(points, axis=1), 1e-300)
    rays = points / distances[:, None]
    # A ray moves by the part of the shift of its point across it, over the distance. Along it nothing is measured.
    across = (np.eye(3) - rays[:, :, None] * rays[:, None]) / distances[:, None, None]
    scatter = across @ covariances @ across + noise_rad**2 * np.eye(3)
    J = np.concatenate([across @ np.cross(np.eye(3), points[:, None]), across], axis=2)
    return np.asarray(np.swapaxes(J, 1, 2) @ np.linalg.solve(scatter, J))


def _position_sigma(information: Floats) -> float:
    """Largest standard deviation of the shift; infinity where it is not determined."""
    units = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(units, units)
    # With three landmarks or fewer the view has several solutions, or none: their information has no full rank then.
    if not np.linalg.eigvalsh(scaled)[0] > 1e-9:
        return math.inf
    covariance = np.linalg.inv(scaled) / np.outer(units, units)
    return math.sqrt(float(np.linalg.eigvalsh(covariance[3:, 3:])[-1]))


def _advice(seen: Floats, step: Floats) -> str:
    """What to do, by whether the camera moved toward what it looks at."""
    centre = np.sum(seen / np.linalg.norm(seen, axis=1, keepdims=True), axis=0)
    along = abs(float(centre @ step)) / max(float(np.linalg.norm(centre) * np.linalg.norm(step)), 1e-300)
    if along > _AHEAD:
        return "the camera moves toward what it looks at, where depths stay unknown: move sideways, or go on"
    return "too few depths are known: keep translating, best sideways"
