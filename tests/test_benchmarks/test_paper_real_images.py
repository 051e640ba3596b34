"""The experiment of the paper on real images, tested on exact matches and on rendered frames."""

from __future__ import annotations

import numpy as np
from make_source import synth

from quest.geometry.quaternion import rotation_from_vector
from quest.solvers.quest6 import quest6
from slam_init.types.pose import Pose
from tests.benchmarks import paper_real_images
from tests.benchmarks.image_pairs import ImagePair
from tests.benchmarks.paper_real_images import measure, read_data_set, sample_of_best

TRUTH = Pose(rotation_from_vector(np.array([0.05, 0.2, -0.1])), np.array([-0.5, 0.1, 0.2]))


def exact_pair(seed, matches=20, outliers=0):
    """Exact matches with random descriptor distances; the first ``outliers`` matches are outliers with distance 0."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-1, -1, 3), (1, 1, 6), (matches, 3))
    seen = TRUTH.apply(points)
    seen[:outliers] = rng.uniform((-1, -1, 3), (1, 1, 6), (outliers, 3))
    distances = np.r_[np.zeros(outliers), rng.uniform(0.1, 1, matches - outliers)]
    m, n = (X / np.linalg.norm(X, axis=1, keepdims=True) for X in (points, seen))
    return ImagePair(m, n, distances, 500.0, TRUTH)


def test_the_sample_holds_the_matches_with_the_smallest_distances_and_is_none_if_there_are_too_few():
    pair = exact_pair(0)
    m, _ = sample_of_best(pair, 6)
    rows = [int(np.flatnonzero((pair.bearings1 == ray).all(axis=1))[0]) for ray in m]
    assert pair.distances[rows].max() < np.delete(pair.distances, rows).min()
    assert sample_of_best(pair, 21) is None
    assert measure(quest6, 21, [pair]) is None


def test_exact_matches_give_exact_poses_by_both_measures():
    errors = measure(quest6, 6, [exact_pair(seed) for seed in range(5)])
    assert errors.clean == 1
    for name in ("closest", "ranked"):
        assert errors.rotation[name].max() < 1e-6
        assert errors.translation[name].max() < 1e-5


def test_an_outlier_among_the_best_matches_spoils_a_sample_and_lowers_the_clean_share():
    errors = measure(quest6, 6, [exact_pair(0), exact_pair(1, outliers=1)])
    assert errors.clean == 0.5
    assert errors.rotation["ranked"][0] < 1e-6 < errors.rotation["ranked"][1]


def test_the_error_of_the_closest_candidate_is_at_most_that_of_the_ranked_candidate():
    rng = np.random.default_rng(0)
    pairs = [exact_pair(seed) for seed in range(10)]
    noisy = [
        ImagePair(p.bearings1 + 2e-3 * rng.normal(size=p.bearings1.shape), p.bearings2, p.distances, 500.0, TRUTH)
        for p in pairs
    ]
    errors = measure(quest6, 6, noisy)
    assert (errors.rotation["closest"] <= errors.rotation["ranked"]).all()


def test_a_sample_without_candidates_counts_as_a_random_guess():
    errors = measure(lambda m, n: np.full((len(m), 3, 4), np.nan), 6, [exact_pair(0)])
    assert (errors.rotation["ranked"], errors.translation["closest"]) == ([0.5], [0.5])
    assert errors.candidates == 0


def test_the_step_gives_a_degree_of_parallax_unless_it_is_given():
    source = synth("room", frames=6, width=320, height=240)
    data = read_data_set("room", source, 1)
    assert data.step > 1  # consecutive frames of the room have less parallax
    assert len(data.pairs) == 1
    assert read_data_set("room", source, 1, step=1).step == 1


def test_the_program_writes_tables_and_plots_of_a_source(tmp_path, capsys):
    assert (
        paper_real_images.main(
            ["synth:desk?frames=6&width=320&height=240", "--pairs", "1", "--step", "5", "--out", str(tmp_path)]
        )
        == 0
    )
    assert capsys.readouterr().out == (tmp_path / "paper_real_images.md").read_text()
    for which in ("rotation", "translation"):
        assert (tmp_path / f"paper_real_images_{which}.png").read_bytes().startswith(b"\x89PNG")
