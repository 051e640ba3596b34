"""Laws of tracks without images: exact ground truth, stated shares, and scenes that are what their name says."""

from itertools import pairwise

import numpy as np
import pytest

from sequences_synth import POINT_SCENES, SCENES, SCENES_WITHOUT_TRANSLATION, STANDARD_SCENES, PointOptions, make_points

TILTED = {"tilted-15": 15, "tilted-30": 30, "tilted-45": 45}
# Scenes whose camera moves in seconds and does not translate by default.
TIMED = ("handheld", "handheld-wall", "pan")
# Largest rotation by the tremor of the hand, degrees: 0.3 about each of three axes.
TREMOR_DEG = 0.52


def reprojected(sequence, index):
    """Pixels of the static points under the true pose."""
    X = (sequence.points - sequence.poses[index, :3, 3]) @ sequence.poses[index, :3, :3]
    return X[:, :2] / X[:, 2:] * sequence.true_camera.fx + [sequence.true_camera.cx, sequence.true_camera.cy]


def test_noise_and_shares_are_the_requested_ones():
    sequence = make_points("room", 2, PointOptions(noise_px=0.7, outliers=0.3, moving=0.2, points=2000))
    assert sequence.is_outlier.mean() == pytest.approx(0.3, abs=0.001)
    assert sequence.is_moving.mean() == pytest.approx(0.2, abs=0.001)
    seen = sequence.visible[5] & ~sequence.is_outlier & ~sequence.is_moving
    residuals = (sequence.pixels[5] - reprojected(sequence, 5))[seen]
    assert residuals.std() == pytest.approx(0.7, rel=0.05)


def test_the_path_of_the_camera_has_the_requested_length_or_is_zero():
    for scene in POINT_SCENES:
        sequence = make_points(scene, 3, PointOptions(baseline=0.2))
        steps = np.linalg.norm(np.diff(sequence.poses[:, :3, 3], axis=0), axis=1)
        if scene in SCENES_WITHOUT_TRANSLATION or scene in TIMED:
            assert steps.sum() == 0
        else:
            # Bend and tremor make the path longer. The median depth in view differs from that of the whole scene.
            assert 0.1 < steps.sum() / np.nanmedian(sequence.depths(0)) < 0.5


def test_the_points_of_a_planar_scene_lie_on_a_plane():
    for scene in ("wall", "nadir", "nadir-turn", *TILTED):
        points = make_points(scene, 4).points
        assert np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] < 1e-9


def test_in_a_rotation_scene_the_true_rotation_maps_the_tracks_only_with_the_true_focal_length():
    sequence = make_points("rotation", 3, PointOptions(focal_error=0.05, noise_px=0, outliers=0))
    both = sequence.visible[0] & sequence.visible[-1]
    last_from_first = sequence.poses[-1, :3, :3].T @ sequence.poses[0, :3, :3]

    def largest_error(camera):
        H = camera.K @ last_from_first @ np.linalg.inv(camera.K)
        mapped = np.column_stack([sequence.pixels[0, both], np.ones(both.sum())]) @ H.T
        return np.abs(mapped[:, :2] / mapped[:, 2:] - sequence.pixels[-1, both]).max()

    assert largest_error(sequence.true_camera) < 1e-9
    assert largest_error(sequence.camera) > 1


def heading_and_tilt(sequence):
    """Unit vectors in the ground plane: direction of flight, and direction in which the camera is tilted."""
    normal = np.linalg.svd(sequence.points - sequence.points.mean(axis=0))[2][2]
    track = sequence.poses[-1, :3, 3] - sequence.poses[0, :3, 3]
    tilt = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    return track / np.linalg.norm(track), tilt / np.linalg.norm(tilt), normal


@pytest.mark.parametrize("scene", TILTED)
def test_a_tilted_scene_is_a_level_flight_with_the_camera_tilted_forward_or_sideways_by_the_angle_in_the_name(scene):
    cosines = []
    for seed in range(12):
        sequence = make_points(scene, seed)
        track, tilt, normal = heading_and_tilt(sequence)
        angles = np.degrees(np.arccos(np.abs(sequence.poses[:, :3, 2] @ normal)))
        np.testing.assert_allclose(angles, TILTED[scene], atol=TREMOR_DEG)
        # The tremor displaces the ends of the path by a hundredth of its length.
        assert abs(track @ normal) < 0.04
        cosines.append(track @ tilt)
    forward = np.isclose(cosines, 1, atol=0.01)
    sideways = np.isclose(cosines, 0, atol=0.05)
    assert (forward | sideways).all()
    assert forward.any() and sideways.any()


def test_the_standard_scenes_are_fixed_and_exist_as_images_and_as_points():
    names = "room wall nadir nadir-turn corridor desk rotation rotate-then-move static"
    assert tuple(names.split()) == STANDARD_SCENES
    assert set(STANDARD_SCENES) < set(SCENES) == set(POINT_SCENES)


ERRORS = [{"field_px": 1.0}, {"drift_px": 2.0}, {"field_px": 0.5, "drift_px": 1.0}]


def grid(sequence, step_px=16):
    """Centres of the squares into which the image is divided, (rows, columns, 2)."""
    width, height = sequence.true_camera.width, sequence.true_camera.height
    x, y = np.meshgrid(np.arange(0, width, step_px), np.arange(0, height, step_px))
    return np.stack([x, y], axis=-1) + 0.5 * (step_px - 1)


def field(sequence, index):
    """Correlated error of one view on the grid, (rows, columns, 2)."""
    pixels = grid(sequence)
    return sequence.tracking_error.at(index, pixels.reshape(-1, 2)).reshape(pixels.shape)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("scene", ["room", "static"])
@pytest.mark.parametrize("errors", ERRORS[1:])
def test_correlated_error_is_the_only_difference_from_the_world_without_it(scene, errors):
    clean = make_points(scene, 8, PointOptions(moving=0.2))
    given = make_points(scene, 8, PointOptions(moving=0.2, **errors))
    for name in ("poses", "points", "is_outlier", "is_moving", "timestamps_s"):
        np.testing.assert_array_equal(getattr(given, name), getattr(clean, name))
    outlier, static = clean.is_outlier, ~(clean.is_outlier | clean.is_moving)
    np.testing.assert_array_equal(given.pixels[:, outlier], clean.pixels[:, outlier])
    for index in range(len(clean)):
        seen = static & clean.visible[index]
        expected = given.tracking_error.at(index, reprojected(clean, index)[seen])
        np.testing.assert_allclose((given.pixels - clean.pixels)[index, seen], expected, atol=1e-9)
    # The tracks of moving bodies are real tracks too.
    shift = (given.pixels - clean.pixels)[-1, clean.is_moving & clean.visible[-1]]
    assert rms(shift) > 0.2


@pytest.mark.parametrize("views", [2, 12])
def test_the_drift_starts_at_zero_grows_in_small_steps_and_ends_at_the_requested_rms(views):
    ends, middles = [], []
    for seed in range(20):
        sequence = make_points("static", seed, PointOptions(views=views, points=5, drift_px=1.5))
        fields = [field(sequence, index) for index in range(views)]
        assert not fields[0].any()
        ends.append(rms(fields[-1]))
        middles.append(rms(fields[views // 2]))
        steps = [rms(b - a) for a, b in pairwise(fields)]
        assert max(steps) < 4 * 1.5 / np.sqrt(views - 1)
    assert ends == pytest.approx([1.5] * 20, rel=0.01)
    # A random walk has half of its final variance after half of the views.
    if views > 2:
        assert rms(middles) == pytest.approx(1.5 * np.sqrt(0.5), rel=0.25)


def test_the_field_has_the_requested_rms_depends_on_the_seed_and_adds_up_with_the_drift():
    both, only_field, only_drift, other = (
        make_points("wall", seed, PointOptions(field_px=a, drift_px=b))
        for seed, a, b in ((1, 0.5, 1.0), (1, 0.5, 0.0), (1, 0.0, 1.0), (2, 0.5, 1.0))
    )
    np.testing.assert_allclose(field(both, 6), field(only_field, 6) + field(only_drift, 6), atol=1e-12)
    assert rms(field(both, 6) - field(other, 6)) > 0.1
    assert [rms(field(only_field, index)) for index in range(12)] == pytest.approx([0.5] * 12, rel=0.01)
    # It is smooth: a polynomial of second degree.
    np.testing.assert_allclose(np.diff(field(both, 6), n=3, axis=0), 0, atol=1e-9)
