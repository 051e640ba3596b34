"""The compiled loops of the patches against the same in numpy."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from slam_init.frontend.patch_kernel import (
    align_patches,
    conditioned_on_maps,
    covariances_in_image,
    cut_patches,
    distribution_of_maps,
)
from slam_init.frontend.patch_size import SIDE_PX, WIDE
from slam_init.frontend.patches import pairs_of


def spd(rng, count, size):
    roots = rng.normal(size=(count, size, size))
    return roots @ np.swapaxes(roots, 1, 2) + 0.1 * np.eye(size)


def test_covariances_turn_with_the_maps_of_the_patches():
    """Place and columns of the map are vectors of the patch."""
    rng = np.random.default_rng(0)
    inverses, slots = spd(rng, 12, 8), np.array([3, 0, 11, 7, 3])
    affine, variances = rng.normal(size=(5, 4)), rng.uniform(0.5, 2, 5)
    A = affine.reshape(5, 2, 2)
    turns = np.zeros((5, 6, 6))
    for rows in ([0, 1], [2, 4], [3, 5]):
        turns[:, np.array(rows)[:, None], rows] = A
    expected = turns @ inverses[slots, :6, :6] @ np.swapaxes(turns, 1, 2) * variances[:, None, None]
    np.testing.assert_allclose(covariances_in_image(slots, inverses, affine, variances), expected, rtol=1e-10)


def test_places_are_conditional_means_given_the_distribution_of_the_maps():
    rng = np.random.default_rng(1)
    covariances, scatter = spd(rng, 6, 6), rng.uniform(0, 1, 4)
    deviations = rng.normal(size=(6, 4))
    gain = covariances[:, :, 2:] @ np.linalg.inv(covariances[:, 2:, 2:] + np.diag(scatter))
    changes, places = conditioned_on_maps(covariances, scatter, deviations)
    np.testing.assert_allclose(changes, np.einsum("npi,ni->np", gain, deviations), rtol=1e-8, atol=1e-10)
    left = covariances[:, :2, :2] - gain[:, :2] @ covariances[:, 2:, :2]
    np.testing.assert_allclose(places, left, rtol=1e-8, atol=1e-10)


def test_a_patch_that_keeps_its_own_map_is_not_changed():
    rng = np.random.default_rng(2)
    covariances, deviations = spd(rng, 2, 6), rng.normal(size=(2, 4))
    deviations[1] = np.nan
    changes, places = conditioned_on_maps(covariances, np.ones(4), deviations)
    assert changes[0].any()
    assert not changes[1].any()
    np.testing.assert_array_equal(places[1], covariances[1, :2, :2])


def readable_distribution_of_maps(places, maps, variances):
    spread = np.maximum(places.std(axis=0), 1.0)
    basis = np.column_stack([np.ones(len(places)), (places - places.mean(axis=0)) / spread])
    weights, means, scatter = 1 / variances, maps, np.zeros(4)
    for _ in range(3):
        normal = np.einsum("ni,nq,nj->qij", basis, weights, basis)
        normal += 1e-6 * normal[:, :1, :1] * np.diag([0.0, 1.0, 1.0])
        solved = np.linalg.solve(normal, np.einsum("ni,nq->qi", basis, weights * maps)[..., None])
        means = basis @ solved[..., 0].T
        squares = (maps - means) ** 2
        scatter = np.maximum(np.median(squares, axis=0) / 0.455 - np.median(variances, axis=0), 0.0)
        sigmas = np.sqrt(squares / (variances + scatter))
        weights = np.minimum(2 / np.maximum(sigmas, 2), 1.0) / (variances + scatter)
    return means, scatter


@pytest.mark.parametrize("count", [24, 31, 400])
@pytest.mark.parametrize("width", [0.0, 600.0])
def test_the_distribution_of_maps_is_that_of_the_readable_fit(count, width):
    """Also where all places have one x, so that nothing tells the slopes along it."""
    rng = np.random.default_rng(count)
    places, variances = rng.uniform(0, (width, 400), (count, 2)), rng.uniform(0.01, 0.2, (count, 4))
    maps = 0.2 + 1e-3 * places @ rng.normal(size=(2, 4)) + np.sqrt(variances) * rng.standard_t(3, (count, 4))
    means, scatter = distribution_of_maps(places, maps, variances)
    expected_means, expected_scatter = readable_distribution_of_maps(places, maps, variances)
    np.testing.assert_allclose(means, expected_means, atol=1e-10)
    np.testing.assert_allclose(scatter, expected_scatter, atol=1e-10)


def readable_cut(image, pixel):
    """Grey levels over the contrast, both slopes, and the inverse of the normal equations of one patch."""
    radius = SIDE_PX // 2
    border = np.arange(-radius - 1, radius + 2)
    rows, columns = pixel[1] + border[:, None], pixel[0] + border[None]
    around = ndimage.map_coordinates(image.astype(float), np.broadcast_arrays(rows, columns), order=1)
    inner = around[1:-1, 1:-1]
    greys = (inner - inner.mean()) / inner.std()
    x, y = 0.5 * (around[1:-1, 2:] - around[1:-1, :-2]), 0.5 * (around[2:, 1:-1] - around[:-2, 1:-1])
    down, across = np.meshgrid(*[border[1:-1] / radius] * 2, indexing="ij")
    one = np.ones_like(x)
    J = np.stack([x, y, x * across, x * down, y * across, y * down, one, greys]).reshape(8, -1)
    return np.stack([greys, x, y]), np.linalg.inv(J @ J.T + np.diag([4.0] * 6 + [0.0] * 2))


def test_patches_are_cut_as_by_the_readable_sums():
    """Also where a patch touches the last pixels of the image; one that leaves it is not cut."""
    rng = np.random.default_rng(3)
    image = cv2.GaussianBlur(rng.integers(0, 255, (60, 70), dtype=np.uint8), (0, 0), 1.5)
    pixels = np.array([[30.2, 28.7], [12.0, 12.0], [56.999, 46.999], [57.0, 30.0], [30.0, 11.9]])
    patches, inverses = np.zeros((5, 3, SIDE_PX, WIDE), np.float32), np.zeros((5, 8, 8))
    slots, brightness = np.array([4, 2, 0, 1, 3]), np.zeros((5, 2))
    cut = cut_patches(pairs_of(image), np.array(image.shape), pixels, slots, patches, inverses, brightness)
    assert cut.tolist() == [True, True, True, False, False]
    for pixel, slot in zip(pixels[cut], slots[cut], strict=True):
        expected, inverse = readable_cut(image, pixel)
        np.testing.assert_allclose(patches[slot, :, :, :SIDE_PX], expected, atol=1e-4)
        np.testing.assert_allclose(inverses[slot], inverse, rtol=1e-4, atol=1e-9)
    assert not patches[:, :, :, SIDE_PX:].any()


def test_a_patch_is_aligned_up_to_the_last_pixels_of_an_image():
    """It comes back to where it was cut from some tenths of a pixel, and not from beyond the image."""
    rng = np.random.default_rng(4)
    image = cv2.GaussianBlur(rng.integers(0, 255, (60, 70), dtype=np.uint8), (0, 0), 1.5)
    true = np.array([[56.9, 46.9], [12.1, 12.1]])
    patches, inverses, brightness = np.zeros((2, 3, SIDE_PX, WIDE), np.float32), np.zeros((2, 8, 8)), np.zeros((2, 2))
    seen, size, slots = pairs_of(image), np.array(image.shape), np.arange(2)
    assert cut_patches(seen, size, true, slots, patches, inverses, brightness).all()
    for start in (true + 0.4, true - 0.4):
        pixels, affine = start.copy(), np.tile([1.0, 0.0, 0.0, 1.0], (2, 1))
        left = align_patches(seen, size, slots, patches, inverses, brightness, pixels, affine)
        np.testing.assert_allclose(pixels, true, atol=0.01)
        assert (left < 0.05).all()
    beyond = np.array([[59.5, 30.0], [30.0, 9.9]])
    assert not np.isfinite(align_patches(seen, size, slots, patches, inverses, brightness, beyond, affine)).any()
