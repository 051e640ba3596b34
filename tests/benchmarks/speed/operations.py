"""Operations of the largest stages, counted from their formulas, and the stages on typical input.

An addition, a multiplication, a division and a root are one operation each. Comparisons are none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_init.config import TrackingConfig
from slam_init.datasets.points import open_points
from slam_init.types.arrays import Bools, Ints
from slam_init.types.camera import Camera
from tests.benchmarks.speed.roofline import Stage, measure_stage

#: The projection of a point by a radial-tangential lens with its derivatives by the point and by k1: x, y (2), the
#: radius (3), radial factor and slope (14), distorted point (20), its derivatives (26), scale (2), pixel (4),
#: derivatives by k1 (4) and by the point (18).
_PROJECTION = 93
#: A point in another frame: the product of a 3x3 matrix and a vector (15), the scaled translation (6).
_MOVED = 21
#: An observation where only the cost is wanted: point, projection, residual, whitening, weight and cost.
_COST = _MOVED + _PROJECTION + 27


def window_operations(seen: Bools, anchor: Ints, lens: int) -> float:
    """Operations of the equations of a window of free points.

    The observation in view k of a track of anchor a, with ``n`` common unknowns of which ``p`` poses (none where k is
    a; view 0 has none) and the lens:

    ==================================================  =============================================
    part                                                operations
    ==================================================  =============================================
    point in the view, projection                       21 + 93
    residual, whitening, robust weight and cost         10 + 6 + 3 + 8
    derivatives by the point, whitened                  24
    derivatives by the point of the anchor, by the ray  60 + 20
    by each pose (a rotation vector, a translation)     36 p
    by the inverse distance, where k is not a           34
    by each unknown of the lens, whitened               12
    3x3 equations of the track and their right side     55
    coupling and gradient of n unknowns                 18 n
    products of n unknowns, lower half                  2 n (n + 1)
    ==================================================  =============================================

    Each track adds its point (21), its tangents (10) and the inverse of its 3x3 equations (45).

    Shapes: ``seen`` (V, T), ``anchor`` (T,).

    * ``anchor``: First view of a track; negative for a track that is left out.
    """
    view, track = np.nonzero(seen & (anchor >= 0))
    others = view != anchor[track]
    poses = np.where(others, (view > 0).astype(int) + (anchor[track] > 0), 0)
    n = 6 * poses + lens
    derivatives = 24 + 60 + 20 + 36 * poses + 34 * others + 12 * lens
    observations = _COST + derivatives + 55 + 18 * n + 2 * n * (n + 1)
    return float(observations.sum()) + 76.0 * int((anchor >= 0).sum())


def elimination_operations(tracks: int, unknowns: int) -> float:
    """Operations of the Schur complement: the product of (3T, G) with itself, of which half is needed.

    These are G^2 multiplications and additions for each of 3T rows, over two; the gradient is a further column. The
    triangular factor of each track is in its rows already.
    """
    return tracks * (3.0 * unknowns**2 + 6.0 * unknowns)


def scoring_operations(matches: int) -> float:
    """Operations of the score of a pose: the squared Sampson error and the signs of the depths of each match.

    The turned ray (15), its products with the baseline (10), the cross product (9), the epipolar error (5), the
    denominator and the quotient (9), cosine and parallax (10), signs (2), sum (1).
    """
    return 61.0 * matches


def flow_operations(width: int, height: int, points: int, window: int, levels: int, iterations: int) -> float:
    """Operations of Lucas-Kanade flow, at most: a point may stop earlier.

    Each pixel of both pyramids is the sum of 5 + 5 weighted pixels (18 for a pixel of the coarser level). Each pixel of
    the first pyramid has two gradients of Scharr (16). On each level a point interpolates its patch and two gradients
    (7 for each value of a pixel) and sums their products (6). An iteration interpolates the patch (7), subtracts (1)
    and sums two products (4).
    """
    pixels = sum(width * height / 4.0**level for level in range(levels + 1))
    coarse = pixels - width * height
    patch = window * window
    return 2 * 18 * coarse + 16 * pixels + points * (levels + 1) * patch * (21 + 6 + 12 * iterations)


def bundle_operations(views: int, landmarks: int) -> float:
    """Operations of one iteration of bundle adjustment, as a Schur complement needs them, for landmarks seen by all.

    An observation: point in the view and projection (21 + 93), derivatives by the pose of 2x6 and by the point of 2x3
    (2 * 2 * 3 * 9), whitened (20), the products of 9 unknowns and a right side (2 * 2 * 9 * 10 / 2); and the error at
    the new values (21 + 40). A landmark: its inverse (45), then 3x3 times 3x6V, and half of the product of (3, 6V) with
    itself. The equations of the poses: a third of the cube of 6V.
    """
    poses = 6 * views
    observation = _MOVED + _PROJECTION + 108 + 20 + 180 + 61
    return landmarks * (views * observation + 45 + 18 * poses + 3 * poses**2) + poses**3 / 3


def measured_stages(calls: int = 15) -> list[Stage]:
    """Measure the stages, each on typical input."""
    return [*_window(calls), _bundle(calls), _scoring(calls), _flow(calls)]


def _window(calls: int) -> list[Stage]:
    from slam_init.window.equations import WindowEquations
    from slam_init.window.state import Priors, start_at
    from slam_init.window.track_equations import eliminate
    from slam_init.window.tracks import gather_tracks

    source = open_points("points:room?views=6&baseline=0.1", 1)
    seen = list(source.observations(0))
    tracks = gather_tracks(_distorted(source.camera), seen, 0.7)
    poses = [pose.inverse() for pose in source.groundtruth.world_from_cam]
    relative = [pose @ poses[0].inverse() for pose in poses]
    start = start_at(tracks, np.array([pose.R for pose in relative]), np.array([pose.t for pose in relative]))
    equations = WindowEquations(tracks, start, Priors())
    unknowns, count = len(equations.gradient), int((tracks.anchor >= 0).sum())
    observations = int(tracks.seen[:, tracks.anchor >= 0].sum())
    size = f"{len(seen)} views, {count} tracks, {observations} observations"
    filled = window_operations(tracks.seen, tracks.anchor, unknowns - 6 * (len(seen) - 1))
    # Of an observation 89 bytes are read or written: pixel 16, deviation 8, whitening 32, rows 16, residual 16, flag 1.
    # Of a track its gradient, inverse and coupling, 8 (12 + 3 G) bytes, and its share of the gradient, 8 G bytes.
    built = measure_stage(
        "window: equations and elimination",
        size,
        filled + elimination_operations(count, unknowns),
        89 * observations + 8 * count * (4 * unknowns + 12),
        lambda: equations.build(start),
        calls,
    )
    cost = measure_stage(
        "window: cost alone", size, _COST * observations + 31 * count, 89 * observations, lambda: equations.cost(start),
        calls,
    )  # fmt: skip
    equations.build(start)
    # The time does not depend on the numbers.
    normal, gradient = equations.normal.copy(), equations.gradient.copy()
    halves = np.random.default_rng(0).normal(size=(len(tracks.track_ids), 3, unknowns + 1))
    eliminated = measure_stage(
        "window: elimination alone",
        f"{count} tracks, {unknowns} unknowns",
        elimination_operations(count, unknowns),
        # The rows are read.
        8 * count * 3 * (unknowns + 1),
        lambda: eliminate(normal, gradient, halves),
        calls,
    )
    return [built, cost, eliminated]


def _distorted(camera: Camera) -> Camera:
    """The camera with a radial-tangential lens, whose projection is the one that is counted."""
    return replace(camera, model="radtan", distortion=(0.0, 0.0, 0.0, 0.0))


def _scoring(calls: int) -> Stage:
    from quest.robust.kernels.scoring import score

    rng = np.random.default_rng(0)
    points = rng.uniform((-1, -1, 2), (1, 1, 4), (5000, 3))
    baseline = np.array([0.2, 0.0, 0.0])
    m, n = (p / np.linalg.norm(p, axis=1, keepdims=True) for p in (points, points + baseline))
    unit = baseline / np.linalg.norm(baseline)
    count = len(m)
    return measure_stage(
        "robust search: score of a pose",
        f"{count} matches",
        scoring_operations(count),
        48 * count,
        lambda: score(m, n, np.eye(3), unit, 4e-3, np.inf),
        10 * calls,
    )


def _flow(calls: int) -> Stage:
    import cv2

    config, iterations, count = TrackingConfig(), 5, 400
    rng = np.random.default_rng(0)
    large = cv2.resize(rng.integers(0, 255, (60, 80), dtype=np.uint8), (660, 500), interpolation=cv2.INTER_CUBIC)
    before, after = (np.ascontiguousarray(large[y : y + 480, x : x + 640]) for x, y in ((0, 0), (4, 3)))
    points = rng.uniform((40, 40), (600, 440), (count, 2)).astype(np.float32)
    levels, window = config.pyramid_levels, config.window_px
    return measure_stage(
        f"flow, at most {iterations} iterations a level",
        f"640x480, {count} points, {window}x{window}, {levels + 1} levels",
        flow_operations(640, 480, count, window, levels, iterations),
        # Both pyramids, and two gradients of 16 bits of the first one; patches stay in the cache.
        (2 + 4) * 640 * 480 * 4 / 3,
        lambda: cv2.calcOpticalFlowPyrLK(
            before, after, points, np.empty_like(points), winSize=(window, window), maxLevel=levels,
            criteria=(cv2.TERM_CRITERIA_COUNT, iterations, 0.0),
        ),
        calls,
    )  # fmt: skip


def _bundle(calls: int) -> Stage:
    from slam_init.bundle.graph import optimize
    from slam_init.bundle.problem import BundleProblem
    from slam_init.types.pose import Pose

    rng = np.random.default_rng(0)
    views, landmarks = 6, 300
    camera = Camera("radtan", 640, 480, 500.0, 500.0, 319.5, 239.5, (0.01, 0.0, 0.0, 0.0))
    points = rng.uniform((-1.0, -0.8, 3.0), (1.0, 0.8, 5.0), (landmarks, 3))
    poses = tuple(Pose(np.eye(3), np.array([0.1 * k, 0.0, 0.0])) for k in range(views))
    pixels = np.concatenate([camera.project(pose.inverse().apply(points)) for pose in poses])
    problem = BundleProblem(
        tuple(range(views)),
        poses,
        points + 0.01 * rng.normal(size=points.shape),
        np.arange(landmarks),
        np.repeat(np.arange(views), landmarks),
        np.tile(np.arange(landmarks), views),
        pixels + 0.5 * rng.normal(size=pixels.shape),
    )

    def optimized(iterations: int) -> Stage:
        # A tolerance of 0 lets all iterations run.
        return measure_stage(
            "bundle adjustment: an iteration of gtsam",
            f"{views} views, {landmarks} landmarks",
            bundle_operations(views, landmarks),
            # Jacobians of 2x9 and a residual of each observation, written and read; the equations of the landmarks.
            8 * (2 * 2 * 10 * views * landmarks + landmarks * 3 * (6 * views + 4)),
            lambda: optimize(camera, problem, 0.7, robust=True, iterations=iterations, tolerance=0.0),
            max(3, calls // 4),
        )

    # The time of an iteration is the difference of two runs: both build the same graph.
    few, many = optimized(2), optimized(6)
    return replace(many, ms=(many.ms - few.ms) / 4)
