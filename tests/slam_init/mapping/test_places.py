"""The place of a map: features that several views see at one point, and nothing else."""

import numpy as np
from make_place import make_place

from slam_init.mapping.places import place_of_features

FOCAL_PX = 500.0


def features(place):
    """Rays and descriptors of each view."""
    rays, described = [], []
    for k in range(len(place.views)):
        rows = place.observation_views == k
        rays.append(place.observation_bearings[rows])
        described.append(place.descriptors[place.observation_points[rows]])
    return rays, described


def test_the_features_of_known_points_give_these_points():
    place = make_place()
    found = place_of_features(place.views, *features(place), FOCAL_PX)
    nearest = np.linalg.norm(found.points[:, None] - place.points, axis=2)
    assert len(found.points) == 120 and nearest.min(axis=1).max() < 1e-6
    np.testing.assert_allclose(found.descriptors, place.descriptors[nearest.argmin(axis=1)], atol=1e-6)
    assert len(found.observation_points) == 480


def test_a_feature_off_its_epipolar_line_makes_no_point():
    place = make_place()
    rays, described = features(place)
    rays = [ray.copy() for ray in rays]
    for k, ray in enumerate(rays):
        ray[:30] += [0, 0.1 * k * k, 0]
    found = place_of_features(place.views, [r / np.linalg.norm(r, axis=1, keepdims=True) for r in rays], described, 500)
    nearest = np.linalg.norm(found.points[:, None] - place.points, axis=2).argmin(axis=1)
    assert 80 < len(found.points) <= 90 and nearest.min() >= 30


def test_no_view_one_view_and_a_camera_that_only_turns_give_no_point():
    place = make_place()
    rays, described = features(place)
    assert len(place_of_features((), [], [], FOCAL_PX).points) == 0
    assert len(place_of_features(place.views[:1], rays[:1], described[:1], FOCAL_PX).points) == 0
    still = (place.views[0],) * 4
    assert len(place_of_features(still, [rays[0]] * 4, [described[0]] * 4, FOCAL_PX).points) == 0
