"""A computation in slices: the same result as in one piece, whatever the slices and the speed of the machine."""

import gc
import threading
import time
import weakref
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make_map import bytes_of
from make_scene import texture
from make_window import point_source

from slam_init import Config, Initializer, SlamInitError
from slam_init import work as work_module
from slam_init.config import MAX_TRACKS_IN_SLICES, TrackingConfig
from slam_init.decision import window_rule
from slam_init.types.camera import Camera
from slam_init.types.stopwatch import Stopwatch
from slam_init.work import Sliced, seconds, spend

#: Every judgement ends in its first slice.
PLENTY = 1e9


def spending(parts, done):
    """A computation that spends in parts, and notes each."""

    def compute():
        for part in parts:
            spend(part)
            done.append(part)
        return sum(parts)

    return compute


@given(st.lists(st.floats(0.1, 50.0), max_size=20), st.floats(1.0, 100.0))
def test_no_slice_spends_more_than_its_work_but_for_a_part_that_alone_exceeds_it(parts, work):
    done = []
    sliced, slices = Sliced(spending(parts, done)), 0
    while not sliced.done:
        before = len(done)
        sliced.run(work)
        spent, slices = done[before:], slices + 1
        assert sum(spent) <= work * (1 + 1e-12) or len(spent) == 1
        assert slices <= len(parts) + 1 + sum(parts) / work
    assert sliced.value == sum(parts)
    assert done == parts


def test_a_part_that_exceeds_its_slice_shortens_the_next_ones():
    done = []
    sliced = Sliced(spending([35.0, 1.0], done))
    counts = []
    while not sliced.done:
        sliced.run(10.0)
        counts.append(len(done))
    assert counts == [1, 1, 1, 2]


def test_without_slices_work_costs_nothing():
    spend(1e12)
    assert seconds() == pytest.approx(time.perf_counter(), abs=1.0)


def test_an_error_of_the_computation_comes_out_of_its_slice():
    def fails():
        spend(5.0)
        spend(5.0)
        raise ValueError("told")

    sliced = Sliced(fails)
    sliced.run(6.0)
    with pytest.raises(ValueError, match="told"):
        sliced.run(6.0)
    assert sliced.done


def test_another_thread_gets_one_clear_line():
    sliced = Sliced(spending([5.0, 5.0], []))
    sliced.run(6.0)
    errors = []

    def elsewhere():
        try:
            sliced.run(6.0)
        except SlamInitError as error:
            errors.append(str(error))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    (line,) = errors
    assert "one thread" in line and "work_per_frame" in line and "\n" not in line


def test_a_paused_computation_takes_no_time():
    stopwatch, sleep_s = Stopwatch(seconds), 0.2

    def compute():
        with stopwatch("stage"):
            spend(1.0)
            spend(1.0)

    sliced = Sliced(compute)
    sliced.run(1.0)
    time.sleep(sleep_s)
    sliced.run(1.0)
    assert sliced.done
    assert stopwatch.summary()["stage"]["total"] < 1e3 * sleep_s


# -- the initializer ------------------------------------------------------------------------------


def run(source, work):
    """The initializer after the tracks of a source, and the statuses."""
    initializer, statuses = Initializer(source.camera, Config(work_per_frame=work)), []
    for observed in source.observations():
        statuses.append(initializer.process_tracks(observed))
        if initializer.map is not None:
            break
    initializer.finish()
    return initializer, statuses


def test_slices_delay_a_judgement_and_change_nothing_else():
    source = point_source("room", 0, baseline=0.3, views=40)
    whole, _ = run(source, PLENTY)
    sliced, statuses = run(source, 5_000.0)
    judged = [status.attempt.frames[1] for status in statuses if status.attempt and status.attempt.window]
    ended = [k for k, status in enumerate(statuses) if status.attempt and status.attempt.window]
    assert all(frame < k for frame, k in zip(judged, ended, strict=True))
    first, again = (next(a for a in one.result.attempts if a.window) for one in (whole, sliced))
    assert first.frames == again.frames
    assert first.window == again.window
    assert sliced.map is not None


@pytest.mark.parametrize("work", [5_000.0, 40_000.0])
def test_the_speed_of_the_machine_changes_no_result(work, monkeypatch):
    """The slow machine takes longer in every stage, and now and then very much longer."""
    source = point_source("room", 1, baseline=0.05, views=60)
    fast, statuses = run(source, work)
    rng, real = np.random.default_rng(0), window_rule.risk_of

    def slow_risk(hypotheses):
        time.sleep(float(rng.choice([0.001, 0.05])))
        return real(hypotheses)

    def slow_spend(amount):
        if rng.random() < 0.01:
            time.sleep(0.002)
        spend(amount)

    monkeypatch.setattr(window_rule, "risk_of", slow_risk)
    monkeypatch.setattr("slam_init.window.equations.spend", slow_spend)
    slow, again = run(source, work)
    assert [(s.state, s.reason, s.progress) for s in statuses] == [(s.state, s.reason, s.progress) for s in again]
    assert (fast.map is None) == (slow.map is None)
    if fast.map is not None:
        assert bytes_of(fast.map) == bytes_of(slow.map)


def test_no_frame_is_given_more_than_its_work(monkeypatch):
    """Of a frame's parts all but the last fit its work: the work that cannot be divided is a part of its own."""
    frames, per_frame = [], 15_000.0
    source = point_source("wall", 0, views=60)
    initializer = Initializer(source.camera, Config(work_per_frame=per_frame))
    real = work_module.Sliced.run

    def noted(self, work):
        frames.append([])
        assert work <= per_frame
        return real(self, work)

    def noted_spend(amount):
        spend(amount)
        frames[-1].append(amount)

    monkeypatch.setattr(work_module.Sliced, "run", noted)
    for name in ("window.equations", "window.locating", "window.tracks", "window.uncertainty", "bundle.graph"):
        monkeypatch.setattr(f"slam_init.{name}.spend", noted_spend)
    for observed in source.observations():
        initializer.process_tracks(observed)
    assert len(frames) > 20
    for parts in frames:
        assert sum(parts[:-1]) <= per_frame


def test_the_end_of_a_sequence_ends_the_judgement_under_way():
    source = point_source("room", 0, baseline=0.3, views=40)
    whole, _ = run(source, PLENTY)
    first = next(attempt for attempt in whole.result.attempts if attempt.window)
    initializer = Initializer(source.camera, Config(work_per_frame=1_000.0))
    for observed, _ in zip(source.observations(), range(first.frames[1] + 2), strict=False):
        assert initializer.process_tracks(observed).window is None
    initializer.finish()
    assert initializer.status.window == first.window


@pytest.mark.parametrize(("interval_s", "share"), [(1 / 30, 1.0), (0.15, 1.0), (0.6, 4.0)])
def test_photographs_have_more_time_than_the_frames_of_a_video(interval_s, share, monkeypatch):
    source = point_source("room", 0, baseline=0.3)
    initializer = Initializer(source.camera, Config(work_per_frame=1_000.0))
    given_work, real = [], work_module.Sliced.run
    monkeypatch.setattr(work_module.Sliced, "run", lambda self, work: (given_work.append(work), real(self, work))[1])
    for k, observed in enumerate(source.observations()):
        initializer.process_tracks(replace(observed, timestamp_s=k * interval_s))
    assert given_work[1] == pytest.approx(1_000.0 * share)


@pytest.mark.parametrize(
    ("work", "interval_s", "alone"),
    [
        (1_000.0, 1 / 30, True),
        (1_000.0, 0.15, True),
        (1_000.0, 0.2, False),
        (1_000.0, None, True),
        (None, 1 / 30, False),
    ],
)
def test_the_frames_of_a_video_that_must_not_wait_are_linked_by_flow_alone(work, interval_s, alone, monkeypatch):
    """Photographs leave the time for descriptors. Images without a time are those of a video."""
    initializer = Initializer(Camera("pinhole", 320, 240, 260.0, 260.0, 159.5, 119.5), Config(work_per_frame=work))
    asked, real = [], initializer.tracker.track

    def noted(frame, *, by_flow_alone=False):
        asked.append(by_flow_alone)
        return real(frame, by_flow_alone=by_flow_alone)

    monkeypatch.setattr(initializer.tracker, "track", noted)
    image = texture(1, 240, 320)
    for k in range(4):
        initializer.process(image, None if interval_s is None else k * interval_s)
    assert asked[1:] == [alone] * 3


@pytest.mark.parametrize(("work", "most"), [(None, 800), (1_000.0, MAX_TRACKS_IN_SLICES)])
def test_frames_that_must_not_wait_follow_fewer_tracks(work, most):
    assert Config(work_per_frame=work).tracking_in_use.max_tracks == most
    few = Config(work_per_frame=work, tracking=TrackingConfig(max_tracks=100, sift_frames=2))
    assert few.tracking_in_use == few.tracking


def test_an_initializer_that_is_left_in_a_judgement_is_freed():
    source = point_source("room", 0, baseline=0.3, views=40)
    initializer = Initializer(source.camera, Config(work_per_frame=1_000.0))
    for observed in source.observations():
        initializer.process_tracks(observed)
    left = weakref.ref(initializer)
    del initializer
    gc.collect()
    assert left() is None
