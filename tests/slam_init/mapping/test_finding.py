"""Frames found in a map: at their true poses; not at all in another world; and where the first views see nothing."""

import numpy as np
import pytest
from make_place import make_place, rays_to

from quest.geometry.quaternion import rotation_from_vector
from slam_init.errors import SlamInitError
from slam_init.mapping.finding import Finder
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame
from slam_init.types.initial_map import Keyframe
from slam_init.types.pose import Pose

CAMERA = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)


def frame_at(shift, turn=0.1):
    return Keyframe(0, 0.0, "", Pose(rotation_from_vector(np.array([0.0, turn, 0.0])), np.array([shift, 0.1, -0.2])))


def seen_from(keyframe, points):
    return rays_to((keyframe,), np.zeros(len(points), int), points)


def test_a_frame_is_found_at_its_pose():
    place, true = make_place(), frame_at(0.7)
    finder = Finder(place, CAMERA)
    found = finder.locate_features(5, 0.5, "5", seen_from(true, place.points), place.descriptors)
    assert found and found.inliers == found.matches == 120 and found.risk < 1e-50
    assert (found.keyframe.frame, found.keyframe.timestamp_s) == (5, 0.5)
    np.testing.assert_allclose(found.keyframe.world_from_cam.t, true.world_from_cam.t, atol=1e-6)
    np.testing.assert_allclose(found.keyframe.world_from_cam.R, true.world_from_cam.R, atol=1e-6)


def test_a_frame_of_another_world_is_not_found():
    place, other = make_place(), make_place(1)
    rays = seen_from(frame_at(0.7), other.points)
    assert not Finder(place, CAMERA).locate_features(0, 0.0, "", rays, other.descriptors)
    # The same look at other places.
    found = Finder(place, CAMERA).locate_features(0, 0.0, "", rays, place.descriptors)
    assert not found and found.matches == 120 and found.risk > 1e-4
    assert not Finder(place, CAMERA).locate_features(0, 0.0, "", np.zeros((0, 3)), np.zeros((0, 128)))


def test_a_finder_refuses_what_is_no_frame_of_its_camera():
    finder, pixels = Finder(make_place(), CAMERA), np.zeros((240, 320), np.uint8)
    with pytest.raises(SlamInitError, match="is 320x240, but the camera is for 640x480"):
        finder.locate(Frame(0, 0.0, "0", pixels))
    with pytest.raises(SlamInitError, match="is no frame"):
        finder.locate(pixels)
    with pytest.raises(SlamInitError, match="a Finder of Place, NoneType"):
        Finder(make_place(), None)  # a video without a calibration


def test_the_place_grows_so_that_frames_beyond_it_are_found():
    """The map knows 60 points; a video sees all of them at first, and then the other 60 alone."""
    whole, known = make_place(), make_place(points=120)
    rows = known.observation_points < 60
    part = type(known)(
        known.views, known.points[:60], known.descriptors[:60], known.observation_views[rows],
        known.observation_points[rows], known.observation_bearings[rows], known.noise_rad,
    )  # fmt: skip
    last = frame_at(1.2)
    for grow in (True, False):
        finder = Finder(part, CAMERA, grow)
        for k in range(4):
            rays = seen_from(frame_at(0.25 * k), whole.points)
            assert finder.locate_features(k, 0.1 * k, "", rays, whole.descriptors)
        assert len(finder.place.points) == (120 if grow else 60)
        found = finder.locate_features(9, 0.9, "", seen_from(last, whole.points[60:]), whole.descriptors[60:])
        assert bool(found) == grow
        if found:
            np.testing.assert_allclose(found.keyframe.world_from_cam.t, last.world_from_cam.t, atol=1e-4)
