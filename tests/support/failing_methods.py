"""Methods that fail in a comparison: each may spoil its own trial only."""

import itertools
import os
import sys

from slam_init.methods.two_view import PairRule


class Raises:
    pair_rule = PairRule(min_features=10, min_matches=10, min_landmarks=10)

    def bootstrap(self, *_):
        raise RuntimeError("no such thing\nas a pose")


class Exits(Raises):
    def bootstrap(self, *_):
        sys.exit(3)


class Aborts(Raises):
    def bootstrap(self, *_):
        os.abort()


class EatsMemory(Raises):
    def bootstrap(self, *_):
        kept = [bytearray(1 << 20)]
        while True:
            kept.append(bytearray(len(kept[-1]) * 2))


class Loops(Raises):
    """Never ends, and no other thread of the interpreter runs."""

    def bootstrap(self, *_):
        sum(itertools.repeat(0))
