"""The sources of a comparison: how they are drawn, opened and described, and where trials start."""

from dataclasses import replace
from urllib.parse import parse_qsl

import numpy as np
import pytest

from slam_init.compare.sources import (
    criteria_of,
    describe_sources,
    drawn_sources,
    focal_error_of,
    grid_sources,
    open_compared,
)
from slam_init.errors import SourceError


def test_the_focal_error_is_read_from_synthetic_sources_only():
    assert focal_error_of("points:rotation?noise_px=1.0&focal_error=-0.02&seed=1") == -0.02
    assert focal_error_of("points:rotation?seed=1") == focal_error_of("folder?focal_error=0.1") == 0.0


def test_a_fixed_option_does_not_change_the_other_drawn_options():
    free, fixed = drawn_sources("wall", 5, 3), drawn_sources("wall", 5, 3, focal_error=0.5)
    for a, b in zip(free, fixed, strict=True):
        values = [dict(parse_qsl(text.partition("?")[2])) for text in (a, b)]
        assert values[1].pop("focal_error") == "0.5"
        values[0].pop("focal_error")
        assert values[0] == values[1]


def test_the_grid_depends_on_the_seed_only():
    assert grid_sources(2, seed=1) == grid_sources(2, seed=1) != grid_sources(2, seed=2)
    described = describe_sources(grid_sources(2, seed=1))
    assert len({source.label for source in described}) == len(described) == 18


def test_the_option_seed_changes_the_world():
    a, b = (open_compared(f"points:room?seed={seed}").sequence for seed in (1, 2))
    assert not np.array_equal(a.poses, b.poses)


@pytest.mark.parametrize("texts", [["points:room", "points:room"], ["points:attic"], ["points:room?seed=-1"]])
def test_repeated_and_unknown_sources_are_errors(texts):
    with pytest.raises(SourceError):
        describe_sources(texts)


def test_a_folder_of_sequences_stands_for_all_sequences_below_it(tmp_path):
    from sequences_synth import SynthOptions, make_sequence, write_tum

    for name in ("a", "deep/b"):
        sequence = make_sequence("room", 0, SynthOptions(frames=2, width=64, height=64))
        write_tum(sequence, tmp_path / name)
    assert [source.label for source in describe_sources([str(tmp_path)])] == ["a", "deep/b"]


def test_trials_start_only_where_half_a_second_of_video_is_left():
    (source,) = describe_sources(["points:room?views=40"])
    assert list(source.starts(10)) == [0, 10, 20]
    assert list(replace(source, frames=9).starts(10)) == [0]


def test_the_criteria_of_a_sequence_do_not_depend_on_the_folder_that_holds_it():
    assert criteria_of("some/where/V1_01_static").no_translation
    assert not criteria_of("redkitchen_a").direction_known
    assert not criteria_of("synth:room").no_translation
