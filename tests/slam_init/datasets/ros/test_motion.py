"""The motion of a camera in bags: topics of poses, fixed transforms, and the inertial sensor, or a note on it."""

from __future__ import annotations

import numpy as np
import pytest
from make_bag import FORMATS, ODOMETRY, POSE, TRANSFORM, Messages, path_for

from quest.geometry.quaternion import rotation_from_vector
from slam_init.datasets import open_source
from slam_init.datasets.inertial import gyroscope_of
from slam_init.datasets.ros.motion import fixed_above
from slam_init.errors import SourceError
from slam_init.types.pose import Pose

pytest.importorskip("rosbags")


def pose(*turn_and_place: float) -> Pose:
    return Pose(rotation_from_vector(np.array(turn_and_place[:3])), np.array(turn_and_place[3:], float))


WORLD_FROM_BODY = [pose(0.1 * k, 0.2, -0.1 * k, k, 0.5 * k, 2) for k in range(4)]
BODY_FROM_MOUNT, MOUNT_FROM_CAM = pose(0.3, 0, 1.2, 0.1, 0, 0.2), pose(-1.5, 0.1, 0, 0, 0.05, 0)
BODY_FROM_CAM = BODY_FROM_MOUNT @ MOUNT_FROM_CAM


def with_images() -> Messages:
    messages = Messages("mcap")
    for k in range(4):
        messages.image("/cam/image_raw", 1 + k / 20, np.zeros((48, 64), np.uint8), "mono8")
    return messages


def with_truth(kind: str = POSE, child: str = "body") -> Messages:
    messages = with_images()
    for k, each in enumerate(WORLD_FROM_BODY):
        messages.pose("/truth", 1 + k / 20, each, kind, child)
    return messages


def fix_camera(messages: Messages, topic: str = "/tf_static") -> None:
    messages.tf(
        topic,
        1.0,
        messages.transform(1.0, "body", "mount", BODY_FROM_MOUNT),
        messages.transform(1.0, "mount", "cam", MOUNT_FROM_CAM),
    )


def assert_poses(source, expected) -> None:
    found = source.groundtruth
    np.testing.assert_allclose(found.timestamps_s, 1 + np.arange(4) / 20)
    for a, b in zip(found.world_from_cam, expected, strict=True):
        np.testing.assert_allclose(a.R, b.R, atol=1e-9)
        np.testing.assert_allclose(a.t, b.t, atol=1e-9)


@pytest.mark.parametrize("kind", [POSE, ODOMETRY, TRANSFORM])
def test_the_pose_of_a_body_becomes_that_of_the_camera(tmp_path, kind):
    messages = with_truth(kind)
    fix_camera(messages)
    source = open_source(messages.write(tmp_path / "bag"))
    assert_poses(source, [each @ BODY_FROM_CAM for each in WORLD_FROM_BODY])
    assert any("the pose of body" in note and "to cam" in note for note in source.notes)


@pytest.mark.parametrize("kind", [POSE, ODOMETRY])
def test_without_a_transform_the_pose_is_that_of_the_body_and_a_note_says_so(tmp_path, kind):
    source = open_source(with_truth(kind).write(tmp_path / "bag"))
    assert_poses(source, WORLD_FROM_BODY)
    assert any("the pose of the body, since the bag has no transform" in note for note in source.notes)


def test_a_body_that_is_the_camera_needs_no_transform(tmp_path):
    source = open_source(with_truth(ODOMETRY, "cam").write(tmp_path / "bag"))
    assert_poses(source, WORLD_FROM_BODY)
    assert any("the pose of cam" in note for note in source.notes)


def test_a_fixed_transform_may_be_sent_again_and_again_and_a_moving_one_is_none(tmp_path):
    for moves in (False, True):
        messages = with_truth(ODOMETRY)
        for k, each in enumerate(WORLD_FROM_BODY):
            fix_camera(messages, "/tf")  # as ROS 1 does
            if moves:
                messages.tf("/tf", 1 + k / 20, messages.transform(1 + k / 20, "mount", "cam", each))
        source = open_source(messages.write(tmp_path / f"bag{moves}"))
        assert_poses(source, [each if moves else each @ BODY_FROM_CAM for each in WORLD_FROM_BODY])


def test_of_several_topics_with_poses_one_must_be_chosen(tmp_path):
    messages = with_images()
    for k, each in enumerate(WORLD_FROM_BODY):
        messages.pose("/a", 1 + k / 20, each)
        messages.pose("/b", 1 + k / 20, pose(0, 0, 0, 0, 0, k))
    path = messages.write(tmp_path / "bag")
    source = open_source(path)
    assert source.groundtruth is None and any("--truth-topic /a or /b" in note for note in source.notes)
    assert_poses(open_source(f"{path}?truth_topic=/a"), WORLD_FROM_BODY)
    assert open_source(f"{path}?truth_topic=none").notes == ()
    with pytest.raises(SourceError, match="no poses in the topic '/c': give --truth-topic /a or /b"):
        open_source(f"{path}?truth_topic=/c")


def test_a_pose_that_is_none_is_refused_by_place(tmp_path):
    messages = with_images()
    broken = pose(0, 0, 0, 0, 0, 0)
    broken.t[0] = np.nan
    messages.pose("/truth", 1.0, broken)
    with pytest.raises(SourceError, match="/truth, message 0: a pose holds a number that is not finite"):
        _ = open_source(messages.write(tmp_path / "bag")).groundtruth


def test_a_circle_of_frames_ends():
    edges = {"a": ("b", pose(0, 0, 0, 1, 0, 0)), "b": ("a", pose(0, 0, 0, 1, 0, 0))}
    assert list(fixed_above(edges, "a")) == ["a", "b"]


# -- the inertial sensor ---------------------------------------------------------------------------


RATE, CAM_FROM_IMU = np.array([0.3, -0.5, 0.2]), rotation_from_vector(np.array([0.4, -1.3, 0.8]))


def with_imu(kind: str, topics=("/imu",), frame: str = "imu") -> Messages:
    messages = Messages(kind)
    for k in range(4):
        messages.image("/cam/image_raw", 10 + k / 20, np.zeros((48, 64), np.uint8), "mono8")
    still = messages.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    rate, zero = (
        messages.make("geometry_msgs/msg/Vector3", x=float(v[0]), y=float(v[1]), z=float(v[2]))
        for v in (RATE, np.zeros(3))
    )
    for topic in topics:
        for k in range(60):
            messages.send(
                topic, "sensor_msgs/msg/Imu", 9.95 + k / 200, header=messages.header(9.95 + k / 200, frame),
                orientation=still, orientation_covariance=np.zeros(9), angular_velocity=rate,
                angular_velocity_covariance=np.zeros(9), linear_acceleration=zero,
                linear_acceleration_covariance=np.zeros(9),
            )  # fmt: skip
    return messages


@pytest.mark.parametrize("kind", FORMATS)
def test_the_transforms_bring_the_rates_to_the_camera(tmp_path, kind):
    messages = with_imu(kind)
    messages.tf("/tf_static", 9.9, messages.transform(9.9, "cam", "imu", Pose(CAM_FROM_IMU, np.ones(3))))
    R, _ = gyroscope_of(open_source(messages.write(path_for(tmp_path, kind)))).between(10.0, 10.1)
    np.testing.assert_allclose(R, rotation_from_vector(-CAM_FROM_IMU @ RATE * 0.1), atol=1e-6)


@pytest.mark.parametrize(
    ("options", "note"),
    [
        ({}, "no transform states its rotation from imu to cam"),
        ({"frame": "cam"}, "no transform"),
        ({"topics": ("/imu", "/imu2")}, "several"),
    ],
)
def test_a_gyroscope_that_cannot_be_used_is_reported(tmp_path, options, note):
    source = open_source(with_imu("mcap", **options).write(tmp_path / "bag"))
    assert gyroscope_of(source) is None
    assert any(note in each for each in source.notes)
