"""Two views of a camera whose focal length is not known."""

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, R_TRUE, T_TRUE, box, is_true, random_rays, views

from quest import InputError, estimate_shared_focal

FOCAL_PX, CENTRE = 400.0, np.array([320.0, 240.0])


def pixels(rays):
    return FOCAL_PX * rays[:, :2] / rays[:, 2:] + CENTRE


def test_the_focal_length_is_within_its_deviations():
    errors = []
    for seed in range(8):
        m, n = views(box(seed, 300), noise_rad=5e-4, outliers=0.3, seed=seed)
        found = estimate_shared_focal(pixels(m), pixels(n), CENTRE, seed=seed)
        errors.append((found.focal_px - FOCAL_PX) / found.sigma_px)
        assert found.focal_px == pytest.approx(FOCAL_PX, rel=0.1)
        assert is_true(found.pose, R_TRUE, T_TRUE, rotation_deg=1.5, direction_deg=6)
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 2


def test_noise_of_pixels_does_not_shorten_the_focal_length():
    ratios = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        rays = np.column_stack([rng.uniform((-320, -240), (320, 240), (300, 2)) / FOCAL_PX, np.ones(300)])
        both = [pixels(view) + rng.normal(0, 0.7, (300, 2)) for view in views(rays * rng.uniform(2, 8, (300, 1)))]
        ratios.append(estimate_shared_focal(*both, CENTRE, seed=seed).focal_px / FOCAL_PX)
    # A pixel at the border is a smaller angle than one in the middle, the more so the shorter the focal length is.
    # Compared by angles, the mean was 0.98 and the least 0.95.
    assert max(np.abs(np.array(ratios) - 1)) < 0.03
    assert 0.99 < np.mean(ratios) < 1.01


def test_a_turn_and_random_matches_have_no_focal_length():
    for m, n in (
        views(box(0), t=NO_TRANSLATION, R=np.eye(3), noise_rad=5e-4),
        views(box(0, 60), t=NO_TRANSLATION, noise_rad=5e-4, outliers=0.7),
        [random_rays(np.random.default_rng(seed), 100) for seed in (0, 1)],
    ):
        found = estimate_shared_focal(pixels(m), pixels(n), CENTRE)
        assert not found


def test_wrong_points_are_refused():
    points = np.zeros((20, 2))
    for one, other, centre in ((points, points[:5], CENTRE), (points, points, CENTRE[:1]), (points, points, (0, 0))):
        with pytest.raises(InputError):
            estimate_shared_focal(one, other, centre)
    few = estimate_shared_focal(points[:8] + np.arange(8)[:, None], points[:8], CENTRE)
    assert few.reason == "too_few_matches"
    with pytest.raises(InputError):
        estimate_shared_focal(points + 1, points, CENTRE, threshold_px=0)
