"""The sources of a comparison: how they are chosen, opened and described, where trials start, and frozen suites."""

from dataclasses import replace

import pytest

from slam_init.compare.criteria import NOT_EVALUATED, Criteria
from slam_init.compare.replay import replay, tracks_digest
from slam_init.compare.sources import describe_sources, open_compared
from slam_init.compare.suites import SUITES
from slam_init.compare.trials import Plan
from slam_init.datasets.views import SourceView
from slam_init.errors import SourceError


def test_repeated_and_unknown_sources_are_errors():
    for texts in (["points:room", "points:room"], ["points:attic"], ["points:room?seed=-1"]):
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
    starts = {least: list(Plan((source,), (), 10, least).starts(source)) for least in (3, 4)}
    assert starts == {3: [0, 10, 20, 30, 40], 4: [0, 10, 20, 30]}
    assert list(Plan((), ()).starts(replace(source, frames=2))) == [0]


def test_a_source_without_ground_truth_is_not_evaluated_unless_its_camera_does_not_translate():
    (source,) = describe_sources(["points:room"])
    assert source.criteria == Criteria()
    assert replace(source, has_truth=False).criteria == NOT_EVALUATED
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


#: Digests of the tracks of some worlds of the suite ``simulated`` as they were frozen.
FROZEN = {0: "462b0b3998e81943", 1: "295ee4652ef771ce", 5: "da366fabfe9ad2b3", 9: "4219f325a7baa9da"}


def test_the_tracks_of_the_worlds_are_the_frozen_ones():
    for world, digest in FROZEN.items():
        text = SUITES["simulated"].worlds[world]
        source = open_compared(text)
        assert tracks_digest(source, text, replay(source, text, 0, "")) == digest


@pytest.mark.parametrize("suite", SUITES)
def test_other_tracks_are_reported(suite):
    digests = ["0" * 16] * len(SUITES[suite].worlds)
    assert "runs on this machine only" in SUITES[suite].verdict(digests)
