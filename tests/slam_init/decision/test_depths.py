"""A map is accepted with known depths only: its share of known depths, their spread, and the targets of the user."""

import numpy as np
import pytest
from make_metric import solve
from make_scene import cloud
from make_window import WINDOW_CONFIG, errors_deg, fed, point_source

from slam_init.config import AcceptanceConfig, Config
from slam_init.decision.depths import KNOWN_SHARE, depth_gates, located_sigma
from slam_init.initializer import Initializer
from slam_init.mapping.resection import resect
from slam_init.types.refusal import GateName, Verdict

NOISE_RAD = 1e-3
DEPTH_GATES = (GateName.KNOWN_DEPTHS, GateName.LOCATED_SIGMA, GateName.PARALLAX_DEG)


def landmarks(rng, count=80, width=1.0):
    """Points ahead of a camera, and covariances along their rays: a twentieth of the distance."""
    points = rng.uniform([-width, -width, 2.0], [width, width, 6.0], (count, 3))
    return points, 0.05**2 * points[:, :, None] * points[:, None, :]


def initialized(source, **targets):
    """The initializer after the tracks of a source, up to the map, and its attempts."""
    config = Config(acceptance=AcceptanceConfig(**targets))
    initializer = fed(Initializer(source.camera, config), source.observations())
    return initializer, initializer.finish().attempts


# -- the view beside the newest keyframe ----------------------------------------------------------


def test_the_stated_deviation_is_the_scatter_of_resections_on_the_worse_half():
    rng = np.random.default_rng(0)
    points, _ = landmarks(rng, 40)
    small, step = np.tile(1e-12 * np.eye(3), (len(points), 1, 1)), 0.5
    places = points[:, :2] / points[:, 2:]
    before = places < np.median(places, axis=0)
    scatters = []
    for half in (*before.T, *~before.T):
        for axis in np.eye(3)[:2]:
            seen = points[half] - step * axis
            shifts = []
            for _ in range(100):
                rays = seen / np.linalg.norm(seen, axis=1, keepdims=True) + NOISE_RAD * rng.normal(size=seen.shape)
                rays /= np.linalg.norm(rays, axis=1, keepdims=True)
                shifts.append(resect(seen, rays, 0.1)[0].t)
            scatters.append(np.sqrt(np.linalg.eigvalsh(np.cov(np.transpose(shifts)))[-1]))
    assert located_sigma(points, small, step, NOISE_RAD) == pytest.approx(max(scatters) / step, rel=0.15)


@pytest.mark.parametrize("count", [0, 1, 3, 5])
def test_too_few_landmarks_do_not_locate_a_view(count):
    assert located_sigma(*landmarks(np.random.default_rng(4), count), 0.3, NOISE_RAD) == np.inf


# -- the gates of a map ---------------------------------------------------------------------------


def test_far_landmarks_have_no_known_depths_and_the_reason_is_low_parallax():
    bundle = solve(cloud(np.random.default_rng(6)) + np.array([0.0, 0.0, 20.0]), 0.5)
    gates = depth_gates(bundle, AcceptanceConfig())
    share = gates[0]
    assert not share.passes()
    assert (share.name, share.threshold, share.reason) == (GateName.KNOWN_DEPTHS, KNOWN_SHARE, Verdict.LOW_PARALLAX)
    assert "translating" in share.advice
    # Landmarks that were left out count as unknown.
    known = (bundle.seen_depth_sigmas <= 0.2).sum()
    assert share.value == known / (len(bundle.depth_sigmas) + bundle.unknown_depths)


# -- the initializer ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def straight_ahead():
    """A camera that moves forward in a corridor: its source, and the initializer up to the map with its attempts."""
    source = point_source("corridor", 6, baseline=0.05, noise_px=0.7, outliers=0.3, points=120)
    return source, *initialized(source)


def test_straight_ahead_the_joint_estimate_holds_the_poses(straight_ahead):
    """Most depths are uncertain, so that the landmarks alone move the motion away."""
    source, initializer, attempts = straight_ahead
    assert any(attempt.map is not None and attempt.map.pose_prior for attempt in attempts)
    rotation, direction = errors_deg(source, initializer.map)
    assert rotation < 1
    assert direction < 15


def test_straight_ahead_the_initializer_waits_until_depths_are_known(straight_ahead):
    """The motion is known after seven frames, and half of the depths are not."""
    _, initializer, attempts = straight_ahead
    refused = [
        one for one in attempts if one.verdict == Verdict.LOW_PARALLAX and one.failed_gates[0].name in DEPTH_GATES
    ]
    assert refused
    assert all(one.window.risk <= WINDOW_CONFIG.acceptance.max_risk for one in refused)
    assert {one.advice for one in refused} == {refused[0].advice}
    assert "sideways" in refused[0].advice
    assert initializer.map is not None
    assert attempts[-1].gates[-3].name == GateName.KNOWN_DEPTHS
    assert attempts[-1].gates[-3].value >= KNOWN_SHARE


@pytest.mark.parametrize("scene", ["room", "wall", "corridor"])
def test_what_is_no_landmark_is_a_track_of_the_newest_keyframe(scene):
    source = point_source(scene, 2, baseline=0.3, points=120)
    map_ = initialized(source)[0].map
    assert (map_.depth_sigmas > 0).all()
    assert map_.depth_sigma == np.median(map_.depth_sigmas)
    newest = map_.keyframes[-1].frame
    assert map_.open_tracks.frame == newest
    assert not np.isin(map_.open_tracks.track_ids, map_.track_ids).any()
    seen = next(one for one in source.observations() if one.frame == newest)
    assert set(seen.track_ids.tolist()) <= {*map_.track_ids.tolist(), *map_.open_tracks.track_ids.tolist()}
    np.testing.assert_allclose(map_.camera.project(map_.open_tracks.bearings), map_.open_tracks.pixels, atol=1e-6)
    assert np.linalg.eigvalsh(map_.point_covariances).min() > 0


def test_stricter_targets_are_waited_for():
    source = point_source("room", 1, baseline=0.3, points=120)
    first, _ = initialized(source)
    by_depth, attempts = initialized(source, max_depth_sigma=0.06)
    assert by_depth.map.depth_sigma < first.map.depth_sigma
    assert by_depth.frames_read > first.frames_read
    assert any(one.verdict == Verdict.LOW_PARALLAX for one in attempts)
    least_deg = 1.2 * first.map.median_parallax_deg
    by_parallax, _ = initialized(source, min_parallax_deg=least_deg)
    assert by_parallax.map.median_parallax_deg >= least_deg


def test_a_target_that_is_never_met_gives_no_map_and_keeps_the_provisional_one():
    initializer, attempts = initialized(point_source("room", 1, baseline=0.3, views=5, points=120), min_parallax_deg=80)
    result = initializer.finish()
    assert (result.map, result.reason) == (None, Verdict.LOW_PARALLAX)
    assert attempts[-1].failed_gates[-1].name == GateName.PARALLAX_DEG
    provisional = initializer.provisional
    assert provisional.risk == provisional.map.risk
    assert provisional.map.model_risk <= WINDOW_CONFIG.acceptance.max_risk
