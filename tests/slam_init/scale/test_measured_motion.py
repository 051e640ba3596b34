"""Laws of the scale by an inertial sensor, and the records and motions that tell none."""

from dataclasses import replace

import numpy as np
import pytest
from make_metric import adjusted_map
from make_scene import cloud

from quest.geometry.quaternion import rotation_from_vector
from sequences_synth.inertial import InertialNoise, measure
from slam_init.datasets import open_source
from slam_init.output.handover import handover_arrays
from slam_init.runner import run
from slam_init.scale.find import find_scale
from slam_init.scale.metric_map import in_metres
from slam_init.scale.requests import parse_scale
from slam_init.types.inertial import InertialRecord
from slam_init.types.pose import Pose

#: A sensor without errors.
EXACT = InertialNoise(0.0, 0.0, 0.0, 0.0, 0.0)
#: Directions of gravity and of the optical axis: the y axis of the camera points down, the z axis of the world up.
LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def swayed(time_s):
    """The pose (4, 4) of a hand that sways by some centimetres twice a second, and walks on."""
    pose, phase = np.eye(4), 2 * np.pi * time_s
    turn = np.array([0.04 * np.sin(1.7 * phase), 0.05 * np.sin(phase + 1), 0.03 * np.cos(1.3 * phase)])
    pose[:3, :3] = LEVEL @ rotation_from_vector(turn)
    pose[:3, 3] = 0.3 * time_s + 0.02 * np.sin(2 * phase), 0.03 * np.sin(phase), 0.04 * np.cos(1.7 * phase)
    return pose


def straight(time_s):
    """A car that drives straight on at a constant speed."""
    pose = np.eye(4)
    pose[:3, :3] = LEVEL
    pose[:3, 3] = 0.5 * time_s, 0.0, 0.0
    return pose


def recorded(path=swayed, noise=None, seed=0):
    """What the sensor measures in the first two seconds."""
    samples = measure(path, np.arange(-0.1, 2.0, 0.005), np.random.default_rng(seed), noise)
    pose = Pose(samples.cam_from_imu[:3, :3], samples.cam_from_imu[:3, 3])
    return InertialRecord(samples.timestamps_s, samples.rates_rad_s, samples.accelerations_m_s2, pose)


def map_of(path=swayed, noise_px=0.2, seed=0, count=8, step_s=0.15):
    """A map of views of the path, in units of its median depth, with the times of the views."""
    times_s = step_s * np.arange(count)
    poses = [Pose(pose[:3, :3], pose[:3, 3]) for pose in map(path, times_s.tolist())]
    first = poses[0].inverse()
    poses = [first @ pose for pose in poses]
    made = adjusted_map(cloud(np.random.default_rng(2)), noise_px, seed, poses)
    keyframes = zip(made.keyframes, times_s.tolist(), strict=True)
    return replace(made, keyframes=tuple(replace(keyframe, timestamp_s=time_s) for keyframe, time_s in keyframes))


def metres_per_unit(map_, path=swayed):
    """By the distance of the last camera from the first."""
    first, last = (path(map_.keyframes[k].timestamp_s)[:3, 3] for k in (0, -1))
    units = np.linalg.norm(map_.keyframes[-1].world_from_cam.t - map_.keyframes[0].world_from_cam.t)
    return np.linalg.norm(last - first) / units


IMU = parse_scale("imu")
MAP = map_of()


def scale_of(map_=MAP, record=None, **more):
    return find_scale(map_, IMU, imu=recorded() if record is None else record, **more)


def test_without_errors_scale_and_gravity_are_exact():
    map_ = map_of(noise_px=1e-3)
    scale = scale_of(map_, recorded(noise=EXACT))
    assert scale.metres_per_unit == pytest.approx(metres_per_unit(map_), rel=2e-3)
    down = swayed(0.0)[:3, :3].T @ [0.0, 0.0, -1.0]
    assert np.degrees(np.arccos(scale.gravity.down @ down)) < 0.2


@pytest.mark.parametrize("seed", range(3))
def test_with_the_noise_of_a_phone_the_truth_is_within_the_stated_deviation(seed):
    map_ = map_of(seed=seed)
    scale = scale_of(map_, recorded(seed=seed))
    assert abs(np.log(scale.metres_per_unit / metres_per_unit(map_))) < 3 * scale.sigma < 0.2
    down = swayed(0.0)[:3, :3].T @ [0.0, 0.0, -1.0]
    assert np.degrees(np.arccos(scale.gravity.down @ down)) < 3.5 * scale.gravity.sigma_deg < 4


def test_another_mount_of_the_same_sensor_changes_nothing():
    turned = Pose(rotation_from_vector(np.array([0.5, -1.2, 2.0])), np.zeros(3))
    record = recorded()
    other = replace(
        record,
        rates_rad_s=record.rates_rad_s @ turned.R,
        accelerations_m_s2=record.accelerations_m_s2 @ turned.R,
        cam_from_imu=record.cam_from_imu @ turned,
    )
    one, two = scale_of(record=record), scale_of(record=other)
    assert two.metres_per_unit == pytest.approx(one.metres_per_unit, rel=1e-3)
    np.testing.assert_allclose(two.gravity.down, one.gravity.down, atol=1e-3)


def test_a_constant_speed_determines_no_scale():
    scale = scale_of(map_of(straight), recorded(straight))
    assert not scale
    assert "move the camera to and fro" in scale.reason


@pytest.mark.parametrize("kind", ["late", "swapped", "another", "still"])
def test_a_record_that_is_not_of_the_camera_is_refused(kind):
    record = recorded()
    wrong = {
        "late": replace(record, timestamps_s=record.timestamps_s + 0.05),
        "swapped": replace(
            record,
            rates_rad_s=record.rates_rad_s[:, [1, 0, 2]],
            accelerations_m_s2=record.accelerations_m_s2[:, [1, 0, 2]],
        ),
        "another": recorded(lambda time_s: swayed(1.3 * time_s + 0.7)),
        "still": recorded(lambda _: swayed(0.0)),
    }[kind]
    scale = scale_of(record=wrong)
    assert not scale
    assert "does not belong to the camera" in scale.reason


def test_three_keyframes_a_gap_a_short_record_and_none_have_reasons():
    record, gap = recorded(), np.r_[0:100, 120:420]
    parts = {"timestamps_s", "rates_rad_s", "accelerations_m_s2"}
    assert "4 are needed" in scale_of(map_of(count=3)).reason
    for kept in (gap, np.arange(200)):
        cut = replace(record, **{name: getattr(record, name)[kept] for name in parts})
        assert "does not cover the keyframes" in scale_of(record=cut).reason
    assert "no record" in find_scale(MAP, IMU).reason


def test_the_grown_map_is_used_and_the_scale_is_that_of_the_accepted_one():
    grown = map_of(count=12)
    half = 0.5
    few = replace(
        MAP,
        keyframes=tuple(
            replace(one, world_from_cam=Pose(one.world_from_cam.R, half * one.world_from_cam.t))
            for one in grown.keyframes[:3]
        ),
    )
    scale = scale_of(few, grown=grown)
    assert scale.metres_per_unit == pytest.approx(metres_per_unit(grown) / half, rel=0.1)
    assert "12 keyframes" in scale.evidence


def test_the_metric_map_hands_gravity_over():
    scale = scale_of()
    metric = in_metres(MAP, scale)
    arrays = handover_arrays(metric)
    np.testing.assert_array_equal(arrays["gravity"], scale.gravity.down)
    assert arrays["gravity_sigma_deg"] == scale.gravity.sigma_deg
    assert np.isnan(handover_arrays(MAP)["gravity"]).all()
    assert "gravity along" in str(metric)


@pytest.mark.slow
def test_a_run_on_a_rendered_room_is_in_metres_by_its_sensor():
    source = open_source("synth:room?imu=1&width=320&height=240&frames=45", 3)
    result, summary = run(source, scale=IMU, continue_frames=20)
    assert result.map.scale.origin == summary.scale_origin.origin == "imu"
    assert abs(summary.ground_truth.scale_error) < 3 * summary.scale_sigma
    first = result.map.keyframes[0]
    down = source.groundtruth.at(first.timestamp_s).R.T @ [0.0, 0.0, -1.0]
    assert np.degrees(np.arccos(summary.gravity.down @ down)) < 3.5 * summary.gravity.sigma_deg
    other, without = run(source, max_frames=2)
    assert (other.map, without.gravity, without.scale_origin) == (None, None, None)
