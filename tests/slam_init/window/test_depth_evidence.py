"""Depths from elsewhere: a right one decides between the twins of a plane; a wrong one is bounded."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import WINDOW_CONFIG, hypotheses_of, pair_and_further, point_source

from quest.geometry.quaternion import rotation_from_vector
from slam_init.errors import SlamInitError
from slam_init.initializer import Initializer
from slam_init.types.depth import Depth, DepthKind, TrackDepths
from slam_init.window.depth_evidence import GivenDepths, inverse_depths
from slam_init.window.levels import LARGEST_DEPTH_VOTE
from slam_init.window.risk import risk_of
from slam_init.window.state import Priors

KINDS = tuple(DepthKind)
SMALL_SIGMA = 0.03


@pytest.fixture(scope="module")
def twins():
    """A plane in two views, which two motions explain alike: the hypotheses and the true depths of the tracks."""
    source = point_source("wall", 0, baseline=0.3)
    observed = list(source.observations())
    found = hypotheses_of(source.camera, pair_and_further([observed[0], observed[-1]], 2), Priors(focal_sigma=0.03))
    true = source.sequence.depths(found.tracks.frames[0])[found.tracks.track_ids]
    return found, true


def given(hypotheses, values, kind=DepthKind.SCALE, sigma=SMALL_SIGMA):
    """Hypotheses with depths of their first view."""
    of_tracks = TrackDepths(hypotheses.tracks.track_ids, values, np.full(len(values), sigma), kind)
    return replace(hypotheses, depths=GivenDepths.of(hypotheses.tracks, [of_tracks, None]))


def as_kind(depths, kind, scale=1.7, shift=0.3):
    """True depths as a kind of measurement states them."""
    if kind == DepthKind.METRIC:
        return depths
    values = 1 / depths if kind == DepthKind.INVERSE else depths
    return scale * (values + (0.0 if kind == DepthKind.SCALE else shift * np.nanmedian(values)))


def test_a_motion_states_the_true_depths_up_to_its_scale(twins):
    hypotheses, true = twins
    errors = []
    for motion in hypotheses.motions[:2]:
        product = true * inverse_depths(motion, motion.frames[0], hypotheses.tracks.track_ids)
        errors.append(np.nanmedian(np.abs(product / np.nanmedian(product) - 1)))
    assert min(errors) < 0.01


def test_the_fixture_is_undecided_and_two_different_planes(twins):
    hypotheses, _ = twins
    assert risk_of(hypotheses).rival > 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_a_right_depth_lowers_the_risk_where_it_confirms_and_raises_it_where_it_contradicts(twins, kind):
    hypotheses, _ = twins
    ids = hypotheses.tracks.track_ids
    best, rival = hypotheses.motions[:2]
    without = risk_of(hypotheses).rival
    for one, other, sign in ((best, rival, 1), (rival, best, -1)):
        depths = 1 / np.maximum(inverse_depths(one, one.frames[0], ids), 1e-9)
        evidence = given(hypotheses, as_kind(depths, kind), kind)
        assert evidence.depths.vote(one, other) == -evidence.depths.vote(other, one) > 0.5
        assert sign * (without - risk_of(evidence).rival) > 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_vote_does_not_depend_on_the_scale_of_the_depths(twins, kind):
    hypotheses, true = twins
    votes = [
        given(hypotheses, factor * as_kind(true, kind), kind).depths.vote(*hypotheses.motions[:2])
        for factor in (1.0, 3.0, 1e-3)
    ]
    assert votes == pytest.approx([votes[0]] * 3, abs=1e-9)


def test_the_vote_is_bounded_whatever_the_depths_are(twins):
    hypotheses, true = twins
    rng = np.random.default_rng(0)
    for values in (rng.uniform(1, 9, len(true)), np.exp(rng.normal(0, 5, len(true))), np.ones(len(true)), true):
        for kind in KINDS:
            vote = given(hypotheses, values, kind, 1e-3).depths.vote(*hypotheses.motions[:2])
            assert abs(vote) <= LARGEST_DEPTH_VOTE


def test_depths_that_fit_no_motion_tell_nothing(twins):
    hypotheses, true = twins
    unrelated = np.exp(np.random.default_rng(1).normal(0, 2, len(true)))
    assert abs(given(hypotheses, unrelated, sigma=0.1).depths.vote(*hypotheses.motions[:2])) < 0.2


def test_unknown_depths_and_few_of_them_are_no_evidence(twins):
    hypotheses, true = twins
    assert given(hypotheses, np.full(len(true), np.nan)).depths is None
    few = np.where(np.arange(len(true)) < 15, true, np.nan)
    assert given(hypotheses, few).depths is None
    known = np.flatnonzero(np.isfinite(true))
    without_some = true.copy()
    without_some[known[::3]] = np.nan
    assert given(hypotheses, without_some).depths.vote(*hypotheses.motions[:2]) != 0.0


def outcomes(source, depth_of):
    """The evidence of each frame as text, and the initializer."""
    initializer, told = Initializer(source.camera, WINDOW_CONFIG), []
    for observed in source.observations():
        status = initializer.process_tracks(observed, depth=depth_of(observed))
        told.append(repr(status.attempt.window) if status.attempt is not None else "")
        if status:
            break
    return told, initializer


def test_depths_that_are_unknown_everywhere_change_nothing():
    source = point_source("wall", 2, baseline=0.05, views=6)
    without, _ = outcomes(source, lambda _: None)
    unknown, _ = outcomes(source, lambda observed: Depth(np.full(len(observed), np.nan)))
    assert unknown == without


@pytest.mark.parametrize("scene", ["rotation", "static"])
def test_no_depth_accepts_a_camera_that_does_not_translate(scene):
    source = point_source(scene, 3, views=6)
    tilt = rotation_from_vector(np.array([0.5, 0.3, 0.0]))[2]

    def of_a_plane(observed):
        return Depth(1 / np.maximum(observed.bearings @ tilt, 0.05), "scale", 0.01)

    (_, without), (_, initializer) = outcomes(source, lambda _: None), outcomes(source, of_a_plane)
    assert without.map is None
    assert initializer.map is None
    assert initializer.result.reason == without.result.reason


def test_a_depth_of_an_image_is_that_of_the_nearest_pixel_at_any_resolution():
    source = point_source("wall", 2, views=2)
    observed = next(iter(source.observations()))
    size = (source.camera.width, source.camera.height)
    columns = np.tile(np.arange(size[0], dtype=float), (size[1], 1)) + 1
    full = Depth(columns, "scale").at(observed.track_ids, observed.pixels, size)
    half = Depth(columns[::2, ::2], "scale").at(observed.track_ids, observed.pixels, size)
    assert np.abs(full.values - 1 - observed.pixels[:, 0]).max() <= 0.5 + 1e-9
    assert np.abs(half.values - full.values).max() <= 1


@pytest.mark.parametrize(
    ("values", "kind", "sigma"),
    [
        (np.ones((2, 2)), "depth", 0.1),
        (np.ones((2, 2, 3)), "scale", 0.1),
        (np.ones((2, 2)), "scale", 0.0),
        (np.ones((2, 2)), "scale", np.ones(3)),
        ("far", "scale", 0.1),
    ],
)
def test_what_is_no_depth_is_refused_in_one_line(values, kind, sigma):
    with pytest.raises(SlamInitError) as error:
        Depth(values, kind, sigma)
    assert "\n" not in str(error.value)


def test_tracks_need_one_depth_each_and_images_an_image():
    source = point_source("wall", 2, views=2)
    observed = next(iter(source.observations()))
    initializer = Initializer(source.camera)
    with pytest.raises(SlamInitError, match="one for each"):
        initializer.process_tracks(observed, depth=Depth(np.ones(3)))
    with pytest.raises(SlamInitError, match=r"\(H, W\)"):
        initializer.process(np.zeros((source.camera.height, source.camera.width), np.uint8), depth=Depth(np.ones(3)))
    assert initializer.frames_read == 0
