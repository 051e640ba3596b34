"""A plain file of an inertial sensor, and the YAML file beside it."""

import numpy as np
import pytest
from make_files import write

from slam_init.datasets import open_source
from slam_init.datasets.inertial import read_inertial_file
from slam_init.datasets.views import GravitySource, read_gravity
from slam_init.errors import SlamInitError, SourceError
from slam_init.types.inertial import Gravity, InertialRecord
from slam_init.types.pose import Pose

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


@pytest.mark.parametrize("down", [(0, 0, 0), (0, 1), (0, np.nan, 1), "down"])
def test_what_is_no_direction_of_gravity_is_refused(down):
    with pytest.raises(SlamInitError, match="gravity"):
        Gravity(down, 1.0)
    with pytest.raises(SlamInitError, match="deviation"):
        Gravity(np.array([0.0, 1.0, 0.0]), np.nan)


def test_a_record_of_other_shapes_is_refused():
    with pytest.raises(SourceError, match="samples"):
        InertialRecord(np.arange(3.0), np.zeros((3, 3)), np.zeros((2, 3)), Pose.identity())
