"""Matches chained to tracks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam_init.datasets.track_source import PairMatches, chain_matches
from slam_init.errors import SourceError


def keypoints(counts):
    """Keypoints at different places."""
    return [np.column_stack([np.arange(n, dtype=float), np.full(n, 7.0 * i)]) for i, n in enumerate(counts)]


def pair(first, second, *matched):
    return PairMatches(first, second, np.array(matched, int).reshape(-1, 2))


def tracks(table):
    """Each track as a set of (image, keypoint)."""
    found = {}
    for frame, track, xy in zip(table.frames.tolist(), table.track_ids.tolist(), table.pixels.tolist(), strict=True):
        found.setdefault(track, set()).add((frame, int(xy[0])))
    return sorted(map(sorted, found.values()))


def test_matches_of_neighbours_make_one_track_through_all_images():
    table, notes = chain_matches(keypoints([3, 3, 3]), [pair(0, 1, (0, 2)), pair(1, 2, (2, 1))], "x")
    assert tracks(table) == [[(0, 0), (1, 2), (2, 1)]]
    assert notes == ()


def test_a_match_that_joins_two_points_of_one_image_is_dropped_and_the_tracks_are_kept():
    # Tracks a = (0,0)-(1,0)-(2,0) and b = (0,1)-(1,1)-(2,1); a wrong match of the far images 0 and 2 joins them.
    right = [pair(0, 1, (0, 0), (1, 1)), pair(1, 2, (0, 0), (1, 1))]
    table, notes = chain_matches(keypoints([2, 2, 2]), [pair(0, 2, (0, 1)), *right], "x")
    assert tracks(table) == [[(0, 0), (1, 0), (2, 0)], [(0, 1), (1, 1), (2, 1)]]
    assert notes[0].startswith("1 matches")


def test_keypoints_at_one_place_are_one():
    points = keypoints([2, 2])
    points[0][1] = points[0][0]  # two orientations of a SIFT feature
    table, notes = chain_matches(points, [pair(0, 1, (0, 0), (1, 0))], "x")
    assert len(tracks(table)) == 1
    assert (len(table.frames), notes) == (2, ())


def test_a_match_of_a_keypoint_that_is_not_there_is_refused():
    with pytest.raises(SourceError, match="names a keypoint"):
        chain_matches(keypoints([2, 2]), [pair(0, 1, (0, 2))], "x")


@given(
    st.lists(st.tuples(*[st.integers(0, 3), st.integers(0, 3), st.integers(0, 4), st.integers(0, 4)]), max_size=25),
    st.randoms(use_true_random=False),
)
@settings(max_examples=60)
def test_the_order_and_the_direction_of_the_pairs_change_nothing_and_no_track_is_twice_in_an_image(matches, random):
    pairs = [pair(i, j, (a, b)) for i, j, a, b in matches]
    table, notes = chain_matches(keypoints([5] * 4), pairs, "x")
    assert len(set(zip(table.frames.tolist(), table.track_ids.tolist(), strict=True))) == len(table.frames)
    assert (np.bincount(table.track_ids, minlength=1) != 1).all()  # a track is seen twice at least
    random.shuffle(pairs)
    swapped = [PairMatches(p.second, p.first, p.keypoints[:, ::-1]) for p in pairs]
    again, notes_again = chain_matches(keypoints([5] * 4), swapped, "x")
    assert tracks(table) == tracks(again)
    assert notes == notes_again
