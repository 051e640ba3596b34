"""Laws of a simulated inertial sensor, and a run in metres with it."""

import numpy as np
import pytest

from sequences_synth import SynthOptions, make_sequence
from sequences_synth.inertial import GRAVITY_M_S2, InertialNoise, measure
from sequences_synth.trajectory import rotation_from_vector

EXACT = InertialNoise(0.0, 0.0, 0.0, 0.0, 0.0)
TIMES = np.arange(0, 1, 0.01)


def test_at_rest_it_measures_gravity_upwards_and_no_rate():
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_vector(np.array([0.3, -0.7, 1.1]))
    samples = measure(lambda _: pose, TIMES, np.random.default_rng(0), EXACT)
    up = (pose @ samples.cam_from_imu)[2, :3]
    np.testing.assert_allclose(samples.accelerations_m_s2, np.tile(GRAVITY_M_S2 * up, (len(TIMES), 1)), atol=1e-6)
    np.testing.assert_allclose(samples.rates_rad_s, 0, atol=1e-9)


def test_on_a_circle_it_measures_the_rate_and_the_acceleration_to_the_centre():
    rate, radius = 2.0, 0.7

    def circle(time_s):
        pose = np.eye(4)
        pose[:3, :3] = rotation_from_vector(np.array([0.0, 0.0, rate * time_s]))
        pose[:3, 3] = pose[:3, :3] @ [radius, 0, 0]
        return pose

    samples = measure(circle, TIMES, np.random.default_rng(1), EXACT)
    R, arm = samples.cam_from_imu[:3, :3], samples.cam_from_imu[:3, 3]
    force = np.array([-(rate**2) * (radius + arm[0]), -(rate**2) * arm[1], GRAVITY_M_S2])
    np.testing.assert_allclose(samples.accelerations_m_s2 @ R.T, np.tile(force, (len(TIMES), 1)), atol=1e-4)
    np.testing.assert_allclose(samples.rates_rad_s @ R.T, np.tile([0, 0, rate], (len(TIMES), 1)), atol=1e-5)


def test_the_errors_have_the_stated_deviations():
    noise = InertialNoise()
    runs = [measure(lambda _: np.eye(4), TIMES, np.random.default_rng(seed), noise) for seed in range(60)]
    rates = np.array([run.rates_rad_s for run in runs])
    assert rates.mean(axis=1).std() == pytest.approx(noise.gyroscope_bias, rel=0.2)
    assert rates.std(axis=1).mean() == pytest.approx(noise.gyroscope_density * 10, rel=0.05)
    forces = np.array([run.accelerations_m_s2 for run in runs])
    assert forces.std(axis=1).mean() == pytest.approx(noise.accelerometer_density * 10, rel=0.05)


def test_a_sequence_has_the_sensor_that_is_asked_for_and_the_same_images():
    small = {"frames": 3, "width": 96, "height": 64}
    without, with_sensor = (make_sequence("room", 1, SynthOptions(**small, imu=imu)) for imu in (False, True))
    assert without.inertial() is None
    samples = with_sensor.inertial()
    assert samples.timestamps_s[0] < 0 and samples.timestamps_s[-1] > with_sensor.timestamps_s[-1]
    np.testing.assert_array_equal(without.render(2)[0], with_sensor.render(2)[0])
    np.testing.assert_array_equal(samples.rates_rad_s, with_sensor.inertial().rates_rad_s)
