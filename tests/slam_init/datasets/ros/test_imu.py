"""The gyroscope of a bag: rotations of the camera where the transforms tell how it is mounted, else a note."""

import numpy as np
import pytest
from make_bag import FORMATS, Messages, path_for

from quest.geometry.quaternion import rotation_from_vector
from slam_init.datasets import open_source
from slam_init.datasets.gyroscope import gyroscope_of
from slam_init.types.pose import Pose

pytest.importorskip("rosbags")

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
