"""Laws of a gyroscope, which measures how the camera turns or says that it does not; a plain file of a sensor."""

from dataclasses import replace
from itertools import pairwise

import make_layouts
import numpy as np
import pytest
from make_files import write

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.config import Config
from slam_init.datasets import open_source
from slam_init.datasets.inertial import Gyroscope, gyroscope_of, inertial_of, read_inertial_file, without_bias
from slam_init.datasets.views import GravitySource, SourceView, read_gravity
from slam_init.errors import SlamInitError, SourceError
from slam_init.initializer import Initializer
from slam_init.runner import run
from slam_init.types.inertial import InertialRecord
from slam_init.types.pose import Pose

TIMES = np.arange(0, 2, 0.005)
CAM_FROM_IMU = rotation_from_vector(np.array([0.4, -1.3, 0.8]))
RATE = np.array([0.3, -0.5, 0.2])


def gyroscope(rates=RATE, times=TIMES, R=CAM_FROM_IMU, **more):
    return Gyroscope(times, np.broadcast_to(rates, (len(times), 3)), R, **more)


def attitude(t):
    """A smooth attitude world_from_imu."""
    wobble = rotation_from_vector(np.array([0.3 * np.sin(4 * t), 0.2 * np.cos(3 * t), 0.0]))
    return wobble @ rotation_from_vector(np.array([0.1, 0.7, -0.4]) * t)


def measured_rates(times, step=1e-5):
    """Angular velocities of the attitude in its own axes, by differences."""
    turns = [attitude(t - step).T @ attitude(t + step) for t in times]
    return np.array([[R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]] for R in turns]) / (4 * step)


def test_a_constant_rate_is_exact_between_samples_too():
    R, _ = gyroscope().between(0.1234, 1.4567)
    np.testing.assert_allclose(R, rotation_from_vector(-CAM_FROM_IMU @ RATE * (1.4567 - 0.1234)), atol=1e-12)


def test_it_is_the_rotation_between_the_cameras_of_a_trajectory():
    measured = gyroscope(measured_rates(TIMES))
    for t0, t1 in [(0.1, 0.15), (0.3021, 0.4777), (0.0, 1.9)]:
        world_from_cam = [attitude(t) @ CAM_FROM_IMU.T for t in (t0, t1)]
        R, sigma_rad = measured.between(t0, t1)
        assert rotation_angle(R @ (world_from_cam[1].T @ world_from_cam[0]).T) < min(1e-4, sigma_rad)


@pytest.mark.parametrize("interval_s", [0.05, 0.2, 1.0])
def test_the_stated_deviation_of_a_chain_covers_a_bias_of_one_sigma(interval_s):
    """The initializer adds the variances of steps although their bias is the same."""
    measured = gyroscope(np.zeros(3), bias_sigma_rad_s=0.02)
    steps = np.arange(0.1, 1.9, interval_s)
    variance = sum(measured.between(a, b)[1] ** 2 for a, b in pairwise(steps))
    assert np.sqrt(variance) >= 0.02 * (steps[-1] - steps[0])


@pytest.mark.parametrize("times", [(-0.1, 0.1), (1.9, 2.1), (0.5, 0.5), (0.6, 0.5), (0.9, 1.1), (np.nan, 1.0)])
def test_nothing_is_measured_outside_of_the_record_across_a_gap_or_backwards(times):
    gap = (TIMES < 0.97) | (TIMES > 1.03)
    assert gyroscope(times=TIMES[gap]).between(*times) is None
    assert gyroscope(times=TIMES[gap]).between(1.1, 1.2) is not None


@pytest.mark.parametrize(
    "broken",
    [
        {"timestamps_s": TIMES[::-1]},
        {"timestamps_s": TIMES[:-1]},
        {"rates_rad_s": np.full((len(TIMES), 3), np.nan)},
        {"R_cam_from_imu": np.diag([1.0, 1.0, -1.0])},
        {"noise_density": -1.0},
    ],
)
def test_what_is_no_record_is_refused(broken):
    with pytest.raises(SourceError):
        replace(gyroscope(), **broken)


def test_the_bias_is_measured_at_rest_and_a_uniform_turn_is_no_rest():
    times, rng = np.arange(0, 10, 0.005), np.random.default_rng(0)
    bias = np.array([-0.002, 0.02, 0.08])
    noise = 0.003 * rng.normal(size=(len(times), 3))
    moving = (times > 4)[:, None] * np.sin(3 * times)[:, None] * RATE
    rested = without_bias(Gyroscope(times, bias + noise + moving, np.eye(3)))
    assert rotation_angle(rested.between(0.1, 2.9)[0]) < 2e-3
    raw = without_bias(Gyroscope(times, bias + noise, np.eye(3)))  # all of it may be a slow pan
    assert raw.bias_sigma_rad_s > rested.bias_sigma_rad_s
    np.testing.assert_array_equal(raw.rates_rad_s, bias + noise)
    two_rates = bias + noise + moving - (times < 1.5)[:, None] * (0.0, 0.0, 0.05)
    assert without_bias(Gyroscope(times, two_rates, np.eye(3))).bias_sigma_rad_s == raw.bias_sigma_rad_s


@pytest.fixture
def euroc(tmp_path):
    """Six images at 20 Hz, and a gyroscope at 200 Hz that turns at a constant rate."""
    stamps = [1403636579763555584 + 50_000_000 * k for k in range(6)]
    mav = make_layouts.euroc(tmp_path, stamps) / "mav0"
    body_from_imu = np.eye(4)
    body_from_imu[:3, :3] = make_layouts.axes("left", "down", "backward") @ CAM_FROM_IMU
    pose = body_from_imu.ravel().tolist()
    write(mav / "imu0" / "sensor.yaml", f"T_BS:\n  data: {pose}\ngyroscope_noise_density: 2e-4\n")
    rates = ",".join(map(str, RATE))
    rows = "".join(f"{stamps[0] - 10_000_000 + 5_000_000 * k},{rates},0,0,9.8\n" for k in range(60))
    write(mav / "imu0" / "data.csv", "#timestamp [ns],w_x,...\n" + rows)
    return mav


@pytest.mark.parametrize("view", [SourceView(), SourceView(every=2), SourceView(fps=10)])
def test_the_gyroscope_of_euroc_is_that_of_the_camera_for_each_view_of_it(euroc, view):
    source = view.apply(open_source(euroc))
    times_s = [frame.timestamp_s for frame in source.frames()]
    R, _ = gyroscope_of(source).between(times_s[0], times_s[1])
    np.testing.assert_allclose(R, rotation_from_vector(-CAM_FROM_IMU @ RATE * (times_s[1] - times_s[0])), atol=1e-7)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("data.csv", "#t\n140363657976355", r"data\.csv:2: expected timestamp,w_x"),
        ("data.csv", "#t\n", "less than two samples"),
        ("data.csv", "2,0,0,0\n1,0,0,0\n", r"data\.csv:2: time stamp 1 does not come after"),
        ("data.csv", "1,0,0,inf\n", r"data\.csv:1"),
        ("data.csv", "1,0,0,0,0,0,9.8\n2,0,0,0.1\n", r"data\.csv:2: has 4 fields"),
        ("sensor.yaml", "rate_hz: 200\n", "T_BS"),
        ("sensor.yaml", f"T_BS: {np.eye(4).ravel().tolist()}\ngyroscope_noise_density: much\n", "noise_density"),
    ],
)
def test_a_broken_gyroscope_of_euroc_is_refused_with_its_file_where_it_is_used(euroc, file, text, message):
    write(euroc / "imu0" / file, text)
    source = open_source(euroc)
    run(source, source.camera, Config(), max_frames=1)
    with pytest.raises(SlamInitError, match=message):
        run(source, source.camera, Config(), max_frames=1, imu=True)


def test_without_the_rotation_of_the_camera_or_the_gyroscope_there_is_none_and_a_note_says_so(euroc):
    (euroc / "imu0" / "sensor.yaml").unlink()
    source = open_source(euroc)
    assert gyroscope_of(source) is None
    assert any("imu0 is not used" in note for note in source.notes)


def test_a_run_gives_the_rotation_since_the_last_frame_that_is_used(euroc, monkeypatch):
    given, process = [], Initializer.process

    def spy(self, image, *arguments, **more):
        given.append(more.get("rotation"))
        return process(self, image, *arguments, **more)

    monkeypatch.setattr(Initializer, "process", spy)
    source = SourceView(every=2).apply(open_source(euroc))
    result, summary = run(source, source.camera, Config(), start=1, imu=True)
    assert given[0] is None and len(given) == 3
    for R in given[1:]:
        np.testing.assert_allclose(R, rotation_from_vector(-CAM_FROM_IMU @ RATE * 0.1), atol=1e-6)
    assert any("imu0 measured 2 of 2 rotations" in note for note in result.notes)
    ignored, without = run(source, source.camera, Config(), start=1)
    assert not any("imu0" in note for note in ignored.notes)
    assert without.provenance.input_blake2b != summary.provenance.input_blake2b


def test_the_accelerations_of_euroc_have_the_pose_of_the_sensor_in_the_camera(euroc):
    record = inertial_of(SourceView(every=2).apply(open_source(euroc)))
    np.testing.assert_allclose(record.cam_from_imu.R, CAM_FROM_IMU, atol=1e-9)
    durations_s, rates, accelerations = record.steps(record.timestamps_s[3] + 0.001, record.timestamps_s[5])
    np.testing.assert_allclose(durations_s, [0.004, 0.005], atol=1e-6)
    np.testing.assert_allclose(rates, [RATE, RATE])
    np.testing.assert_allclose(accelerations, [[0, 0, 9.8]] * 2)
    assert record.gyroscope_density == 2e-4
    table = euroc / "imu0" / "data.csv"
    write(table, "".join(",".join(line.split(",")[:4]) + "\n" for line in table.read_text().splitlines()[1:]))
    assert inertial_of(open_source(euroc)) is None
    assert gyroscope_of(open_source(euroc)) is not None


# -- a plain file ----------------------------------------------------------------------------------


POSE = [[1, 0, 0, 0.01], [0, -1, 0, 0.02], [0, 0, -1, 0.03], [0, 0, 0, 1]]
ROWS = "t,gx,gy,gz,ax,ay,az\n" + "".join(f"{12 + k / 200},0.1,0.2,{k},0,9.8,0.5\n" for k in range(50))


@pytest.fixture
def table(tmp_path):
    write(tmp_path / "record.yaml", f"T_cam_imu: {POSE}\n")
    write(tmp_path / "record.csv", ROWS)
    return tmp_path / "record.csv"


def test_the_columns_and_the_pose(table):
    sensor = read_inertial_file(table)
    np.testing.assert_allclose(sensor.record.rates_rad_s[7], [0.1, 0.2, 7])
    np.testing.assert_allclose(sensor.record.accelerations_m_s2[7], [0, 9.8, 0.5])
    np.testing.assert_allclose(sensor.record.cam_from_imu.matrix(), POSE)
    assert sensor.gyroscope.clock_sigma_s == sensor.record.clock_sigma_s == 0.005


def test_the_names_of_kalibr_and_nanoseconds(table):
    write(table.with_suffix(".yaml"), f"cam0:\n  T_cam_imu: {POSE}\n  timeshift_cam_imu: 0.25\n"
          "imu0:\n  accelerometer_noise_density: 0.004\n")  # fmt: skip
    rows = "".join(f"{(12 + k / 200) * 1e9:.0f} 0 0 0 0 0 9.8\n" for k in range(50))
    write(table, rows)
    record = read_inertial_file(table).record
    np.testing.assert_allclose(record.timestamps_s[[0, 10]], [11.75, 11.80])
    assert (record.accelerometer_density, record.clock_sigma_s) == (0.004, 0.001)


@pytest.mark.parametrize(
    ("suffix", "text", "message"),
    [
        (".yaml", "rate: 200\n", "T_cam_imu is missing"),
        (".yaml", "T_cam_imu: [1, 2, 3]\n", "T_cam_imu is missing or not"),
        (".yaml", f"T_cam_imu: {np.ones((4, 4)).tolist()}\n", "not a rotation"),
        (".yaml", f"T_cam_imu: {[[1, 0, 0, 30], *POSE[1:]]}\n", "30 m away"),
        (".yaml", f"T_cam_imu: {POSE}\ntimeshift_cam_imu: soon\n", "timeshift_cam_imu is 'soon'"),
        (".yaml", f"T_cam_imu: {POSE}\naccelerometer_noise_density: 50\n", "accelerometer_noise_density"),
        (".csv", "1,0,0,0,0,0,9.8\n", "less than two samples"),
        (".csv", "1,0,0,0,0,0,9.8\n1,0,0,0,0,0,9.8\n", "does not come after"),
        (".csv", "1,0,0,0,0,0,9.8\n2,0,0,nan,0,0,9.8\n", r"record\.csv:2"),
        (".csv", "1,0,0,0,0,0,9.8\n2,0,0,0,0,0,-1e300\n", r"record\.csv:2: -1e\+300 is no measurement"),
    ],
)
def test_a_broken_file_is_refused_with_its_name(table, suffix, text, message):
    write(table.with_suffix(suffix), text)
    with pytest.raises(SlamInitError, match=message):
        read_inertial_file(table)


def test_a_file_that_is_not_there_is_named_before_the_one_beside_it(tmp_path):
    with pytest.raises(SourceError, match=r"absent\.csv"):
        read_inertial_file(tmp_path / "absent.csv")


def test_the_note_states_how_many_frames_have_gravity(tmp_path):
    source = open_source("synth:room")
    write(tmp_path / "gravity.txt", "0.0 0 1 0\n500 0 1 0\n")
    frames = GravitySource(source, read_gravity(tmp_path / "gravity.txt"), "gravity of gravity.txt")
    assert frames.notes[-1] == "gravity of gravity.txt"
    assert [frame.gravity is not None for frame in frames.frames(0, 3)] == [True, False, False]
    assert frames.notes[-1] == "gravity of gravity.txt: 1 of 3"


def test_without_the_pose_of_the_sensor_there_is_a_line_that_says_what_to_write(table):
    table.with_suffix(".yaml").unlink()
    with pytest.raises(SourceError, match="write T_cam_imu"):
        read_inertial_file(table)


def test_a_record_of_other_shapes_is_refused():
    with pytest.raises(SourceError, match="samples"):
        InertialRecord(np.arange(3.0), np.zeros((3, 3)), np.zeros((2, 3)), Pose.identity())
