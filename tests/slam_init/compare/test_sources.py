"""The sources of a comparison: how they are drawn, opened and described, and where trials start."""

from dataclasses import replace
from urllib.parse import parse_qsl

import numpy as np
import pytest
from make_files import picture, write, write_image

from slam_init.compare.judging import NOT_JUDGED, Criteria
from slam_init.compare.plan import Plan
from slam_init.compare.sources import describe_sources, focal_error_of, grid_sources, open_compared, simulated_sources
from slam_init.datasets.views import SourceView
from slam_init.errors import SourceError


def test_the_focal_error_is_read_from_synthetic_sources_only():
    assert focal_error_of("points:rotation?noise_px=1.0&focal_error=-0.02&seed=1") == -0.02
    assert focal_error_of("points:rotation?seed=1") == focal_error_of("folder?focal_error=0.1") == 0.0


def test_a_fixed_option_does_not_change_the_other_drawn_options():
    free, fixed = simulated_sources("wall", 5, 3), simulated_sources("wall", 5, 3, focal_error=0.5)
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


def test_trials_start_at_every_kth_frame_that_leaves_enough_frames():
    (source,) = describe_sources(["points:room?views=43"])
    assert list(source.starts(10, 3)) == [0, 10, 20, 30, 40]
    assert list(source.starts(10, 4)) == [0, 10, 20, 30]
    assert list(replace(source, frames=2).starts(10, 3)) == [0]


def test_a_set_of_few_photographs_has_trials_as_well():
    (source,) = describe_sources(["points:room?views=9"])
    plan = Plan((source,), ("stella",), every=1)
    assert [trial.start for trial in plan.trials()] == list(range(7))
    limits = [plan.settings.frames_limit(source, start) for start in plan.starts(source)]
    assert limits == [9, 8, 7, 6, 5, 4, 3]


def test_a_source_without_ground_truth_is_not_judged_unless_its_camera_does_not_translate():
    (source,) = describe_sources(["points:room"])
    assert source.criteria == Criteria()
    assert replace(source, has_truth=False).criteria == NOT_JUDGED
    assert replace(source, group="x/V1_01_static", has_truth=False).criteria.no_translation


def test_a_view_leaves_frames_out_and_the_rest_is_numbered_from_0():
    (whole,) = describe_sources(["synth:room?frames=10&width=64&height=64"])
    (part,) = describe_sources(["synth:room?frames=10&width=64&height=64"], SourceView(every=3))
    assert (part.label, part.group) == (whole.label, whole.group)
    assert (whole.frames, part.frames) == (10, 4)
    assert part.fps == pytest.approx(whole.fps / 3)
    frames = list(open_compared(part.text).frames(1))
    assert [frame.index for frame in frames] == [1, 2, 3]
    assert [frame.name for frame in frames] == ["frame-000003", "frame-000006", "frame-000009"]


def test_large_images_are_reduced_as_a_run_reduces_them(tmp_path):
    for k in range(2):
        write_image(tmp_path / f"{k}.png", picture(k, (2561, 64), 1))
    camera = "model: pinhole\nwidth: 2561\nheight: 64\nfx: 2000\nfy: 2000\ncx: 1280\ncy: 31.5\n"
    write(tmp_path / "camera.yaml", camera)
    source = open_compared(str(tmp_path))
    assert (source.camera.width, source.camera.height, source.camera.fx) == (1280, 32, 1000)
    assert next(source.frames(1)).image.shape == (32, 1280)
