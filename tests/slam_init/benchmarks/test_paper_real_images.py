"""The paper's experiment on real images, on exact matches and on rendered frames."""

from __future__ import annotations

import numpy as np
import pytest
from make_source import synth

from quest.geometry.quaternion import rotation_from_vector
from quest.solvers.quest6 import quest6
from slam_init.benchmarks import paper_real_images
from slam_init.benchmarks.image_pairs import ImagePair
from slam_init.benchmarks.paper_real_images import measure, read_data_set, sample_of_best
from slam_init.types.pose import Pose

TRUTH = Pose(rotation_from_vector(np.array([0.05, 0.2, -0.1])), np.array([-0.5, 0.1, 0.2]))


def exact_pair(seed, matches=20, wrong=0):
    """Exact matches in random order of distance; the first ``wrong`` of them are best and wrong."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((-1, -1, 3), (1, 1, 6), (matches, 3))
    seen = TRUTH.apply(points)
    seen[:wrong] = rng.uniform((-1, -1, 3), (1, 1, 6), (wrong, 3))
    distances = np.r_[np.zeros(wrong), rng.uniform(0.1, 1, matches - wrong)]
    m, n = (X / np.linalg.norm(X, axis=1, keepdims=True) for X in (points, seen))
    return ImagePair(m, n, distances, 500.0, TRUTH)


def test_the_sample_is_that_of_the_best_matches_and_none_where_there_are_too_few():
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


def test_a_wrong_match_among_the_best_spoils_a_sample_and_is_told():
    errors = measure(quest6, 6, [exact_pair(0), exact_pair(1, wrong=1)])
    assert errors.clean == 0.5
    assert errors.rotation["ranked"][0] < 1e-6 < errors.rotation["ranked"][1]


def test_the_closest_candidate_is_never_farther_than_the_first_by_rank():
    rng = np.random.default_rng(0)
    pairs = [exact_pair(seed) for seed in range(10)]
    noisy = [
        ImagePair(p.bearings1 + 2e-3 * rng.normal(size=p.bearings1.shape), p.bearings2, p.distances, 500.0, TRUTH)
        for p in pairs
    ]
    errors = measure(quest6, 6, noisy)
    assert (errors.rotation["closest"] <= errors.rotation["ranked"]).all()


def test_no_candidate_counts_as_a_blind_guess():
    errors = measure(lambda m, n: np.full((len(m), 3, 4), np.nan), 6, [exact_pair(0)])
    assert (errors.rotation["ranked"], errors.translation["closest"]) == ([0.5], [0.5])
    assert errors.candidates == 0


def test_frames_are_as_far_apart_as_a_degree_of_parallax_takes():
    source = synth("room", frames=6)
    data = read_data_set("room", source, 1)
    assert data.step > 1  # the room is a video
    assert len(data.pairs) == 1
    assert read_data_set("room", source, 1, step=1).step == 1


def test_the_program_takes_a_source_and_writes_tables_and_plots(tmp_path, capsys):
    assert paper_real_images.main(["synth:desk?frames=6", "--pairs", "1", "--step", "5", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out == (tmp_path / "paper_real_images.md").read_text()
    for which in ("rotation", "translation"):
        assert (tmp_path / f"paper_real_images_{which}.png").read_bytes().startswith(b"\x89PNG")


def test_without_data_the_program_says_where_it_looked(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SLAM_INIT_DATA", str(tmp_path))
    assert paper_real_images.main([]) == 2
    assert "SLAM_INIT_DATA" in capsys.readouterr().err


@pytest.mark.parametrize("options", [["--pairs", "0"], ["--step", "x"]])
def test_bad_options_are_refused(options, capsys):
    with pytest.raises(SystemExit) as error:
        paper_real_images.main(options)
    assert error.value.code == 2
    assert "error:" in capsys.readouterr().err
