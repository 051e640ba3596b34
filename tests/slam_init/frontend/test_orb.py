"""Descriptors of landmarks are those of ORB's own detector, and those of the newest keyframe at hand."""

import cv2
import numpy as np
from make_map import make_map
from make_scene import texture

from slam_init.frontend.orb import describe_landmarks, orb_descriptors


def test_at_the_corners_of_orb_the_descriptors_are_those_of_orb():
    image = texture(3, 240, 320)
    corners, expected = cv2.ORB.create(nfeatures=200, nlevels=1).detectAndCompute(image, None)
    found, known = orb_descriptors(image, np.array([corner.pt for corner in corners]))
    assert known.all()
    # The orientation of OpenCV is rounded, which moves a point of the pattern now and then.
    different = np.unpackbits(found ^ expected, axis=1).sum(axis=1)
    assert np.mean(different == 0) > 0.9
    assert different.max() <= 8


def test_landmarks_have_the_descriptor_of_the_newest_image():
    map_ = make_map()
    images = {keyframe.frame: texture(k, 480, 640) for k, keyframe in enumerate(map_.keyframes)}
    descriptors, described = describe_landmarks(map_, images)
    last = map_.observation_keyframes == len(map_.keyframes) - 1
    landmarks = map_.observation_landmarks[last]
    expected, known = orb_descriptors(images[map_.keyframes[-1].frame], map_.observation_pixels[last])
    np.testing.assert_array_equal(descriptors[landmarks], expected)
    np.testing.assert_array_equal(described[landmarks], known)
    assert not described[0]  # only the first two keyframes see landmark 0
    assert not descriptors[~described].any()
    assert not describe_landmarks(map_, {999: images[map_.keyframes[0].frame]})[1].any()
