"""Laws of the overview: the same bytes for the same run, a picture for each end of a run, no trace in matplotlib."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from make_map import make_attempts, make_map, make_result, make_truth
from make_summary import summarize
from report_run import report_run

from slam_init.pictures.overview import (
    Story,
    StoryRecorder,
    overview_png,
)
from slam_init.types.evidence import FreeFocal, Margin
from slam_init.types.reasons import Verdict
from slam_init.types.result import Segment


@pytest.fixture(scope="module")
def story():
    recorder = StoryRecorder()
    report_run(recorder)
    return recorder.story()


def draw(result, story, truth=None, name="arc"):
    summary = summarize(result)
    return overview_png(result, replace(summary, source=replace(summary.source, name=name)), story, truth)


def picture(png):
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)


def undecided():
    map_ = make_map()
    result = make_result(None, Verdict.AMBIGUOUS_PLANE)
    return replace(result, hypotheses=(map_, map_), margin=Margin(3.0, 1.0))


def test_equal_runs_have_equal_pictures_whatever_the_user_set_in_matplotlib(story):
    import matplotlib

    result, truth = make_result(make_map()), make_truth(make_map())
    first = draw(result, story, truth)
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "red", "figure.dpi": 50}):
        before = dict(matplotlib.rcParams)
        assert draw(result, story, truth) == first
        assert dict(matplotlib.rcParams) == before
    assert picture(first).shape == (1000, 1600, 3)


def test_each_end_of_a_run_has_a_picture_of_its_own(story):
    ends = (make_result(make_map()), undecided(), make_result(None, Verdict.PURE_ROTATION))
    pictures = [picture(draw(result, story)).astype(int) for result in ends]
    assert all(np.any(one != other) for one, other in pairwise(pictures))
    dark = [np.mean(one[320:700, 770:].max(axis=2) < 60) for one in pictures]  # maps have a dark ground
    assert dark[0] > 0.5 and dark[1] > 0.5 > dark[2]


@pytest.fixture
def told(monkeypatch):
    """The texts that are written into the picture."""
    texts = []
    monkeypatch.setattr("slam_init.pictures.overview.write", lambda axes, x, y, text, *_: texts.append(text))
    return texts


def test_a_wrong_focal_length_is_written_into_the_picture_of_each_end(story, told):
    wrong = FreeFocal(1230.0, 616.0, 22.0, contradicts=True)
    for result in (make_result(make_map()), make_result(None, Verdict.LOW_PARALLAX)):
        draw(replace(result, wrong_focal=wrong), story)
        assert any(" ".join(text.split()) == wrong.note for text in told)
        told.clear()


def test_a_run_without_a_frame_or_an_attempt_has_a_picture_and_names_are_no_mathematics():
    result = replace(make_result(None, Verdict.TOO_FEW_FRAMES), attempts=(), frames_read=0)
    png = draw(result, Story(), name="$x^{ \u202e\udcff 地図\n")
    assert picture(png).shape == (1000, 1600, 3)


def test_a_run_that_started_anew_has_a_row_for_each_map_and_the_story_of_the_first(story):
    map_ = make_map()
    segments = tuple(Segment(map_, 10 * k, 5, lost_at=9 + 10 * k) for k in range(3))
    shown = picture(draw(replace(make_result(map_), segments=segments), story))
    dark = np.mean(shown[300:700, 770:1000].max(axis=2) < 60, axis=1) > 0.5
    assert np.count_nonzero(np.diff(dark.astype(int)) == 1) + int(dark[0]) == 3

    recorder = StoryRecorder()
    report_run(recorder)
    pair = recorder.story().pair
    recorder.restarted()
    recorder.attempt(make_attempts(map_)[-1])
    assert recorder.story().pair is pair
