"""A method that raises; others are in :mod:`hostile`."""

from slam_init.methods.two_view import PairRule


class Raises:
    pair_rule = PairRule(min_features=10, min_matches=10, min_landmarks=10)

    def bootstrap(self, *_):
        raise RuntimeError("no such thing\nas a pose")
