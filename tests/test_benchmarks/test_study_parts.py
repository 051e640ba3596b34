"""The worlds of the study follow the documented distribution."""

from urllib.parse import parse_qsl

import numpy as np
import pytest

from slam_init.compare.sources import GRID, open_compared
from tests.benchmarks.study_parts import PARTS, sources_of


def options_of(text):
    return {key: float(value) for key, value in parse_qsl(text.partition("?")[2])}


@pytest.mark.parametrize("name", PARTS)
def test_worlds_are_distinct_and_follow_the_documented_distribution(name):
    for cell in PARTS[name].cells(7, seed=3):
        assert len(set(cell.sources)) == len(cell.sources) == 7
        for options in map(options_of, cell.sources):
            assert options["noise_px"] in GRID["noise_px"]
            assert options["baseline"] in GRID["baseline"]
            assert 0.05 <= options["outliers"] <= 0.3
            assert abs(options["focal_error"]) in ((0.02, 0.05, 0.1) if name == "wrong-focal" else (0.0, 0.05))


def test_a_world_in_two_cells_is_listed_once():
    """A world that draws a noise of 1 px is equal to the world whose noise is fixed at 1 px."""
    cells = PARTS["hard"].cells(12, seed=0)
    texts = [text for cell in cells for text in cell.sources]
    assert {source.text for source in sources_of(cells)} == set(texts)
    assert len(sources_of(cells)) < len(texts)


def test_a_wrong_focal_length_does_not_change_the_pixels():
    cells = {cell.name: cell for cell in PARTS["static"].cells(1, seed=0)}
    right, wrong = (
        open_compared(cells[f"rotation, {name}"].sources[0]).sequence for name in ("true focal length", "5 % too long")
    )
    np.testing.assert_array_equal(right.pixels, wrong.pixels)
    assert wrong.camera.fx == pytest.approx(1.05 * right.camera.fx)
