"""Laws of the ground: the height of the camera above it, and refusals where no plane is certain."""

import numpy as np
import pytest
from make_metric import adjusted_map, true_scale

from quest.geometry.quaternion import rotation_from_vector
from slam_init.scale.ground import find_ground
from slam_init.scale.requests import NoScaleError
from slam_init.types.pose import Pose

#: A camera that moves ahead and to the side, 1.5 m above the ground.
HEIGHT = 1.5
POSES = [
    Pose(rotation_from_vector(np.array([0.0, 0.01 * k, 0.0])), np.array([0.1 * k, 0.0, 0.2 * k])) for k in range(4)
]
#: One that moves to the side.
SIDE = [Pose(np.eye(3), np.array([0.2 * k, 0.0, 0.0])) for k in range(4)]


def ground(rng, count):
    """Points of a floor that the camera sees."""
    points = np.stack([rng.uniform(-1.5, 1.5, count), np.full(count, HEIGHT), rng.uniform(4.5, 9.0, count)], axis=1)
    points[:, 0] *= points[:, 2] / 4.5
    return points


def boxes(rng, count):
    """Points above the floor."""
    return rng.uniform([-1.5, -1.2, 4.5], [1.5, 1.0, 9.0], (count, 3))


def height_m(map_):
    return find_ground(map_).height * true_scale(map_, POSES)


def test_the_height_above_a_floor_with_boxes():
    rng = np.random.default_rng(3)
    map_ = adjusted_map(np.concatenate([ground(rng, 100), boxes(rng, 100)]), 0.1, poses=POSES)
    assert height_m(map_) == pytest.approx(HEIGHT, rel=0.05)


def test_a_floor_of_a_camera_that_looks_down_lies_ahead():
    points = np.random.default_rng(3).uniform([-1.5, -1.0, 4.0], [1.5, 1.0, 4.0], (200, 3))
    map_ = adjusted_map(points, 0.1, poses=SIDE)
    assert find_ground(map_, nadir=True).height * true_scale(map_, SIDE) == pytest.approx(4.0, rel=0.02)
    with pytest.raises(NoScaleError):
        find_ground(map_)


def test_of_two_floors_the_lower_one_is_the_ground():
    rng = np.random.default_rng(5)
    map_ = adjusted_map(np.concatenate([ground(rng, 120) * [1, 0.5, 1], ground(rng, 120)]), 0.1, poses=POSES)
    assert height_m(map_) == pytest.approx(HEIGHT, rel=0.05)


@pytest.mark.parametrize(
    "make",
    [
        lambda rng: rng.uniform([-1.5, -1.2, 4.5], [1.5, 1.5, 9.0], (200, 3)),
        lambda rng: ground(rng, 200) * [1, -1, 1],
        lambda rng: rng.uniform([-2, -1.5, 6], [2, 1.5, 6], (200, 3)),
    ],
    ids=["nothing flat", "a ceiling", "a wall ahead"],
)
def test_what_is_no_certain_ground_is_refused(make):
    with pytest.raises(NoScaleError, match=r"\w"):
        find_ground(adjusted_map(make(np.random.default_rng(5)), 0.1, poses=POSES))
