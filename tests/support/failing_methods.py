"""Methods that fail in different ways; a comparison must survive them."""

import os
import time

import numpy as np

from slam_init.methods.two_view import PairRule


class _Method:
    pair_rule = PairRule(min_features=10, min_matches=10, min_landmarks=10)


class Raises(_Method):
    def bootstrap(self, *_):
        raise RuntimeError("no such thing\nas a pose")


class Hangs(_Method):
    def bootstrap(self, *_):
        time.sleep(1000)


class Crashes(_Method):
    def bootstrap(self, *_):
        os.abort()


class Eats(_Method):
    def bootstrap(self, *_):
        eaten = []
        while True:
            eaten.append(np.ones(2_000_000))
