"""Laws of the scale by each kind of known length, and reasons where there is none."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from make_bundle import ROTATING
from make_map import make_truth
from make_metric import SQUARE, TARGET, adjusted_map, true_scale
from make_scene import CAMERA, cloud

from slam_init.scale.find import find_scale
from slam_init.scale.requests import parse_scale
from slam_init.types.pose import Pose
from slam_init.types.scale import ScaleOrigin

MAP = adjusted_map(cloud(np.random.default_rng(2)), 0.1)
SIDE_M = 0.12
#: Texels of a printed marker: those of its black square, and of the white margin.
_BLACK, _MARGIN = 320, 40


#: Targets face the camera: their z axis points to it. The second one is beside the first.
FACING = Pose(TARGET.R @ np.diag([1.0, -1.0, -1.0]), TARGET.t)
BESIDE = Pose(FACING.R, FACING.t - [0.25, 0.0, 0.0])


def photographs(map_, *markers):
    """Grey images of printed markers (number, side in metres, pose) in the keyframes."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * _BLACK + _MARGIN - 0.5
    images = {}
    for keyframe, pose in zip(map_.keyframes, ROTATING, strict=True):
        image = np.full((480, 640), 128, np.uint8)
        for number, side_m, target in markers:
            printed = np.pad(cv2.aruco.generateImageMarker(dictionary, number, _BLACK), _MARGIN, constant_values=255)
            pixels = CAMERA.project(pose.inverse().apply(target.apply(side_m * SQUARE)))
            H = cv2.getPerspectiveTransform(corners.astype(np.float32), pixels.astype(np.float32))
            shown = cv2.warpPerspective(np.ones_like(printed), H, (640, 480)) > 0
            image = np.where(shown, cv2.warpPerspective(printed, H, (640, 480), flags=cv2.INTER_AREA), image)
        images[keyframe.frame] = cv2.GaussianBlur(image, (0, 0), 0.8)
    return images


ONE = photographs(MAP, (3, SIDE_M, FACING))


def test_the_scale_of_a_marker_in_the_images():
    scale = find_scale(MAP, parse_scale(f"marker:4x4_50:{SIDE_M}"), images=ONE)
    assert scale.origin == ScaleOrigin.MARKER
    assert scale.metres_per_unit == pytest.approx(true_scale(MAP), rel=4 * scale.sigma)
    assert scale.sigma < 0.02
    assert "5 of 5 sightings of 1 target" in scale.evidence


def test_twice_the_side_is_twice_the_scale_and_the_deviation_of_the_side_counts():
    images = ONE
    one, two = (find_scale(MAP, parse_scale(f"marker:4x4_50:{s}"), images=images) for s in (SIDE_M, 2 * SIDE_M))
    assert two.metres_per_unit == pytest.approx(2 * one.metres_per_unit)
    stated = find_scale(MAP, parse_scale(f"marker:4x4_50:{SIDE_M}+-{0.1 * SIDE_M}"), images=images)
    assert stated.sigma == pytest.approx(np.hypot(one.sigma, 0.1))


def test_images_without_a_marker_or_without_keyframes_determine_nothing():
    request, images = parse_scale("marker:tag36h11:0.1"), ONE
    assert "no marker of tag36h11" in find_scale(MAP, request, images=images).reason
    assert find_scale(MAP, request).reason
    others = {frame + 1: image for frame, image in images.items()}
    assert find_scale(MAP, parse_scale("marker:4x4_50:0.1"), images=others).reason


def test_two_markers_of_different_sizes_contradict_each_other():
    request = parse_scale(f"marker:4x4_50:{SIDE_M}")
    same = find_scale(MAP, request, images=photographs(MAP, (3, SIDE_M, FACING), (9, SIDE_M, BESIDE)))
    other = find_scale(MAP, request, images=photographs(MAP, (3, SIDE_M, FACING), (9, 1.3 * SIDE_M, BESIDE)))
    assert "10 of 10 sightings of 2 targets" in same.evidence
    assert not other
    assert "different scales" in other.reason


def test_the_distance_between_the_first_and_the_last_keyframe():
    metres = true_scale(MAP) * np.linalg.norm(MAP.keyframes[-1].world_from_cam.t)
    scale = find_scale(MAP, parse_scale(f"distance:{metres}"))
    assert scale.metres_per_unit == pytest.approx(true_scale(MAP), rel=1e-6)
    assert scale.sigma == pytest.approx(1e-3, rel=1e-3)  # the range of the gauge is this distance


def test_the_distance_between_two_frames_that_are_keyframes_or_located():
    located = replace(MAP.keyframes[-1], frame=90)
    length = np.linalg.norm(MAP.keyframes[-1].world_from_cam.t - MAP.keyframes[1].world_from_cam.t)
    first = MAP.keyframes[1].frame
    by_keyframe = find_scale(MAP, parse_scale(f"distance:2,{first},{MAP.keyframes[-1].frame}"))
    by_located = find_scale(MAP, parse_scale(f"distance:2,{first},90"), located=[located])
    assert by_keyframe.metres_per_unit == by_located.metres_per_unit == pytest.approx(2 / length)
    assert 0 < by_keyframe.sigma < by_located.sigma < 0.1
    assert "frame 90" in find_scale(MAP, parse_scale(f"distance:2,{first},90")).reason


def test_the_scale_of_the_ground_truth():
    scale = find_scale(MAP, parse_scale("groundtruth"), groundtruth=make_truth(MAP, 2.5))
    assert scale.metres_per_unit == pytest.approx(2.5)
    assert find_scale(MAP, parse_scale("groundtruth")).reason
    assert "two are needed" in find_scale(MAP, parse_scale("groundtruth"), groundtruth=_moved(MAP)).reason


def _moved(map_):
    truth = make_truth(map_)
    return replace(truth, timestamps_s=truth.timestamps_s + 100)


def test_a_map_of_no_ground_gives_the_reason():
    scale = find_scale(MAP, parse_scale("height:1.5"))
    assert not scale
    assert scale.reason
    assert "no scale from height" in str(scale)
