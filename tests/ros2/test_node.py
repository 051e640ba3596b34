"""The lifecycle node of docs/ros2, with a fake of rclpy."""

import cv2
import numpy as np
import pytest
from make_bag import Messages
from make_files import picture
from ros_graph import fake_graph
from slam_init_ros.ros_messages import ros_covariance

from quest.geometry.quaternion import rotation_from_vector
from slam_init import Initializer, open_source
from slam_init.config import load_config
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

pytestmark = pytest.mark.process

pytest.importorskip("rosbags")
#: A date of today's size: as a float of seconds it has steps of 240 ns.
START_NS = 1_700_000_000_123_456_789


@pytest.fixture
def graph():
    with fake_graph() as made:
        yield made


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def image(pixels, time_ns, frame="cam0"):
    messages = Messages("mcap")
    messages.image("", 0.0, pixels, "mono8" if pixels.ndim == 2 else "bgr8", frame)
    message = messages.sent[0][3]
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, 10**9)
    return message


def info(camera, **more):
    messages = Messages("mcap")
    messages.camera_info("", 0.0, camera, frame="cam0", **more)
    return messages.sent[0][3]


def values(status):
    return {pair.key: pair.value for pair in status.status[0].values}


def active(node):
    assert "SUCCESS" in str(node.trigger_configure())
    assert "SUCCESS" in str(node.trigger_activate())
    return node


@pytest.mark.slow
def test_a_run_publishes_the_map_of_the_api_with_the_stamps_of_the_images(graph, tmp_path):
    source = open_source("synth:room?width=320&height=240&slow_start=1")
    frames = list(source.frames(max_frames=12))
    initializer = Initializer(source.camera, load_config(None, {"refine_frames": 0}))
    count = next(k for k, frame in enumerate(frames, 1) if initializer.process(frame.image, START_NS / 1e9 + k / 30))
    direct = initializer.map
    stamps = [START_NS + k * 10**9 // 30 for k in range(1, len(frames) + 1)]

    node = active(graph.node(out=str(tmp_path / "out"), recording=str(tmp_path / "run.rrd")))
    graph.send("/camera_info", info(source.camera))
    for frame, time_ns in zip(frames, stamps, strict=True):
        graph.send("/image", image(frame.image, time_ns))
    sent = graph.received
    statuses = sent["/slam_init/status"]
    assert [stamp(one) for one in statuses] == stamps
    assert [one.status[0].level for one in statuses] == [1] * (count - 1) + [0] * (len(frames) - count + 1)
    assert values(statuses[-1])["landmarks"] == str(len(direct.points)) and values(statuses[0])["advice"]
    assert 0 < float(values(statuses[-1])["risk"]) <= 0.005

    assert len(sent["/slam_init/keyframes"]) == len(direct.keyframes)
    for one, view, covariance in zip(
        sent["/slam_init/keyframes"], direct.keyframes, direct.pose_covariances, strict=True
    ):
        place, expected = one.pose.pose.position, view.world_from_cam
        np.testing.assert_allclose([place.x, place.y, place.z], expected.t, atol=1e-9)
        moments = ros_covariance(expected, covariance)
        np.testing.assert_allclose(np.reshape(one.pose.covariance, (6, 6)), moments, rtol=1e-6, atol=1e-12)
        assert stamp(one) == stamps[view.frame] and one.header.frame_id == "map"
    located = [*(view.frame for view in direct.keyframes), *range(count, len(frames))]
    transforms = [one.transforms[0] for one in sent["/tf"]]
    assert [stamp(one) for one in transforms] == [stamps[frame] for frame in located]
    assert {(one.header.frame_id, one.child_frame_id) for one in transforms} == {("map", "cam0")}
    (static,) = sent["/tf_static"][0].transforms
    assert (static.header.frame_id, static.child_frame_id) == ("world", "map")
    (path,), (cloud,) = sent["/slam_init/path"], sent["/slam_init/points"]
    assert len(path.poses) == len(direct.keyframes) and cloud.width == len(direct.points)
    xyz = np.frombuffer(cloud.data.tobytes(), [("xyz", "<f4", 3), ("rgb", "<u4")])["xyz"]
    np.testing.assert_allclose(xyz, direct.points, rtol=1e-6, atol=1e-6)

    # Another place: the map is lost, and the node looks for the next one.
    graph.send("/image", image(picture(1, frames[0].image.shape[1::-1]), stamps[-1] + 10**8))
    assert values(statuses[-1])["state"] == "lost" and values(statuses[-1])["landmarks"] == "0"
    assert not (tmp_path / "run.rrd").exists()
    assert "SUCCESS" in str(node.trigger_deactivate())
    assert (tmp_path / "run.rrd").stat().st_size > 10_000 and (tmp_path / "out" / "summary.json").exists()
    graph.send("/image", image(frames[0].image, stamps[-1] + 2 * 10**8))
    assert len(statuses) == len(frames) + 1, "an inactive node takes no image"
    for transition in ("activate", "deactivate", "cleanup", "configure"):
        assert "SUCCESS" in str(getattr(node, f"trigger_{transition}")()), transition


CAMERA = Camera("pinhole", 64, 48, 60.0, 61.0, 31.5, 23.5)


def test_images_wait_for_a_calibration_and_those_that_come_late_or_do_not_fit_are_left_out(graph):
    active(graph.node(tf="none"))
    statuses = graph.received["/slam_init/status"]
    graph.send("/image", image(picture(), START_NS))
    graph.send("/camera_info", info(CAMERA, k=np.zeros(9)))
    graph.send("/image", image(picture(), START_NS))
    assert statuses == [], "a driver without a calibration sends zeros"
    graph.send("/camera_info", info(CAMERA))
    for time_s, size in ((1.0, (64, 48)), (0.5, (64, 48)), (1.1, (32, 24)), (1.2, (64, 48))):
        graph.send("/image", image(picture(0, size), START_NS + round(1e9 * time_s)))
    assert [(stamp(one) - START_NS) / 1e9 for one in statuses] == [1.0, 1.2]
    assert ["does not come after" in text for text in graph.warnings] == [True, False]
    assert set(graph.received) == {"/slam_init/status"}, "tf is none"


def test_compressed_images_and_a_calibration_by_parameter(graph):
    node = active(graph.node(compressed=True, camera="auto", tf="map", world_frame="odom"))
    messages = Messages("mcap")
    messages.compressed("", 0.0, cv2.imencode(".png", picture())[1].tobytes(), "png", frame="")
    graph.send("/image/compressed", messages.sent[0][3])
    (status,), (static,) = graph.received["/slam_init/status"], graph.received["/tf_static"]
    assert status.status[0].hardware_id == "camera", "the images name no frame"
    assert (static.transforms[0].header.frame_id, static.transforms[0].child_frame_id) == ("map", "odom")
    node.trigger_deactivate()
    graph.send("/image/compressed", messages.sent[0][3])
    assert len(graph.received["/slam_init/status"]) == 1


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"tf": "base_link"}, "camera or map"),
        ({"config": "absent.toml"}, "absent.toml"),
        ({"refine_frames": 10**9}, ""),
        ({"queue": 0}, "queue is 0"),
        ({"map_frame": "world"}, "two different names"),
        ({"world_frame": ""}, "two different names"),
        ({"camera": "absent.yaml"}, "camera: absent.yaml cannot be read"),
        ({"camera": "f=none"}, "f=1250"),
        ({"out": __file__}, "is a file"),
        ({"recording": "absent/run.rrd"}, "in a folder that exists"),
    ],
)
def test_a_node_with_a_wrong_parameter_stays_unconfigured_and_says_why(graph, parameters, said):
    node = graph.node(**parameters)
    assert "FAILURE" in str(node.trigger_configure()) and node.state == "unconfigured"
    assert len(graph.warnings) == 1 and said in graph.warnings[0]


def test_a_covariance_in_ros_is_that_of_small_motions_in_the_axes_of_the_map():
    rng, step = np.random.default_rng(0), 1e-6
    pose = Pose(rotation_from_vector(np.array([0.7, -1.1, 0.4])), np.array([1.0, 2.0, -1.0]))
    root = rng.normal(0, 0.003, (6, 6))
    columns = []
    for w, v in (step * np.eye(6)).reshape(-1, 2, 3):
        turn = pose.R @ rotation_from_vector(w) @ pose.R.T  # in the axes of the map
        vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        columns.append(np.concatenate([pose.R @ v, vector]) / step)
    moved = np.array(columns).T @ root
    np.testing.assert_allclose(ros_covariance(pose, root @ root.T), moved @ moved.T, rtol=1e-6, atol=1e-12)
