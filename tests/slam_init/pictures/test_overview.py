"""Laws of the overview: the same bytes for the same run, a picture for each end of a run, no trace in matplotlib."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from make_map import make_attempts, make_map, make_result, make_truth, make_window_evidence
from make_summary import summarize
from report_run import report_run

from slam_init.pictures import drawing, overview
from slam_init.recording.recorder import StoryRecorder
from slam_init.types.evidence import FreeFocal, Margin
from slam_init.types.refusal import GateName, Verdict, at_most
from slam_init.types.result import Segment


@pytest.fixture(scope="module")
def story():
    recorder = StoryRecorder()
    report_run(recorder)
    return recorder


def draw(result, story, truth=None, name="arc"):
    summary = summarize(result)
    return overview.overview_png(result, replace(summary, source=replace(summary.source, name=name)), story, truth)


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
    dark = [np.mean(one[200:900, 680:].max(axis=2) < 60) for one in pictures]  # maps have a dark ground
    assert dark[0] > 0.5 and dark[1] > 0.5 > dark[2]


@pytest.fixture
def reported(monkeypatch):
    """The texts that are written into the picture."""
    texts = []
    monkeypatch.setattr("slam_init.pictures.drawing.write", lambda axes, x, y, text, *_: texts.append(text))
    return texts


def test_a_wrong_focal_length_is_written_into_the_picture_of_each_end(story, reported):
    wrong = FreeFocal(1230.0, 616.0, 22.0, contradicts=True)
    for result in (make_result(make_map()), make_result(None, Verdict.LOW_PARALLAX)):
        draw(replace(result, wrong_focal=wrong), story)
        assert any(" ".join(text.split()) == wrong.note for text in reported)
        reported.clear()


def test_a_run_without_a_frame_or_an_attempt_has_a_picture_and_names_are_no_mathematics():
    result = replace(make_result(None, Verdict.TOO_FEW_FRAMES), attempts=(), frames_read=0)
    png = draw(result, StoryRecorder(), name="$x^{ \u202e\udcff 地図\n")
    assert picture(png).shape == (1000, 1600, 3)


def artists_of(draw_into):
    """What a panel holds: the labels of its lines, and its collections."""
    with drawing.canvas(800, 400) as figure:
        axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
        draw_into(axes)
        return [line.get_label() for line in axes.lines], list(axes.collections)


#: Rows and columns of the four maps of a run.
Y1, Y2, X1, X2 = slice(250, 500), slice(650, 900), slice(700, 1050), slice(1180, 1550)


def attempts_of(count, every, verdict):
    window, attempt = make_window_evidence(0.4), make_attempts(make_map())[0]
    return [replace(attempt, frames=(0, every * (k + 1)), window=window, verdict=verdict) for k in range(count)]


def test_a_long_failure_shows_the_risk_alone():
    for count, verdict, has_terms in (
        (120, Verdict.LOW_PARALLAX, False),
        (8, Verdict.LOW_PARALLAX, True),
        (120, Verdict.ACCEPTED, True),
    ):
        attempts = attempts_of(count, 1, verdict)
        labels, _ = artists_of(lambda axes, attempts=attempts: drawing.draw_decision(axes, attempts))
        assert any(label.startswith("part:") for label in labels) == has_terms
        assert "risk" in labels


def test_a_run_that_started_again_shows_each_map(story):
    map_ = make_map()
    segments = tuple(Segment(map_, 10 * k, 5, lost_at=9 + 10 * k) for k in range(3))
    shown = picture(draw(replace(make_result(map_), segments=segments), story)).max(axis=2) < 60
    corners = [np.mean(shown[rows, columns]) > 0.5 for rows in (Y1, Y2) for columns in (X1, X2)]
    assert corners == [True, True, True, False]


def test_the_head_states_the_focal_length_every_note_and_the_gate_that_refused(story, reported):
    result = make_result(None, Verdict.LOW_PARALLAX)
    notes = ("the first note", "the second note")
    gate = at_most(GateName.RISK, 0.42, 0.005, Verdict.LOW_PARALLAX)
    attempts = (*result.attempts[:-1], replace(result.attempts[0], gates=(gate,)))
    draw(replace(result, notes=notes, camera=make_map().camera, attempts=attempts), story)
    text = "\n".join(reported)
    assert all(f"note: {note}" in text for note in notes)
    assert "focal length 5" in text and "fitted" not in text and "direction of the baseline" in text
    assert "0.42" in reported and "at most 0.005" in reported


def test_every_verdict_has_a_colour_of_its_own():
    assert set(drawing.VERDICT_COLORS) == set(Verdict)
    assert len(set(drawing.VERDICT_COLORS.values())) == len(Verdict)
