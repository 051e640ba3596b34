"""From two or more arrays of matched points, of LightGlue or any other matcher, to a map.

Run it as ``python docs/examples/matched_points.py``: it matches simulated views.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from slam_init import Camera, Initializer, Result


def map_of_matches(views: Sequence[ArrayLike], K: ArrayLike, size: tuple[int, int]) -> Result:
    """Initialize from the pixels (N, 2) of the same N points in each view; size is (width, height)."""
    initializer = Initializer(Camera.from_K(K, size))
    for pixels in views:
        initializer.process_tracks(np.arange(np.shape(pixels)[0]), pixels)
    return initializer.finish()


def main() -> None:
    """Match three simulated views of a box of points."""
    rng = np.random.default_rng(0)
    K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    points = rng.uniform((-1.0, -0.8, 2.0), (1.0, 0.8, 4.0), (300, 3))
    views = [(points - (0.2 * k, 0, 0)) @ K.T for k in range(3)]
    result = map_of_matches([v[:, :2] / v[:, 2:] + 0.3 * rng.normal(size=(300, 2)) for v in views], K, (640, 480))
    print(result)
    if result:
        result.save("matched-points")


if __name__ == "__main__":
    main()
