"""The wait: the number of frames after the start frame until the first correct map.

A wait of 1 is the least possible: a correct map at the second frame. A trial without a correct map counts as its limit,
which is the number of frames after the start frame that the trial can read. The mean of these values is the restricted
mean of the wait. Trials of sequences without ground truth, and of cameras that do not translate, have no wait.

Trials of one sequence overlap and are not independent. The intervals are therefore those of a bootstrap over sequences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam_init.compare.statistics import Interval, cluster_mean
from slam_init.compare.trial_table import TrialTable
from slam_init.types.arrays import Bools, Floats


@dataclass(frozen=True)
class WaitDifference:
    """The waits of two methods on the same trials."""

    #: first, second: The methods.
    first: str
    second: str
    #: Number of trials that both methods ran and that have a wait.
    trials: int
    #: Number of sequences of these trials.
    sequences: int
    #: Mean of the wait of the first method minus that of the second one, in frames. The interval is that of a
    #: bootstrap over sequences; its ends are NaN for a single sequence.
    difference_frames: Interval


def waits(table: TrialTable) -> Floats:
    """Return the wait (N,) of each trial in frames; NaN for a trial in which no map can be correct."""
    limits = table.numbers["frames_limit"] - 1
    frames = np.where(table.text["outcome"] == "correct", table.numbers["frames_to_accept"] - 1, limits)
    return np.where(table.solvable, np.minimum(frames, limits), np.nan)


def mean_wait(table: TrialTable, mask: Bools) -> Interval:
    """Compute the restricted mean of the wait of some trials in frames: ``mask`` (N,)."""
    mask = mask & table.solvable
    return cluster_mean(waits(table)[mask], table.text["source"][mask])


def wait_differences(table: TrialTable, methods: Sequence[str], mask: Bools) -> list[WaitDifference]:
    """Compare the wait of the first method with that of each other method, trial by trial: ``mask`` (N,)."""
    values, mask = waits(table), mask & table.solvable
    by_method = {method: table.by_trial(values, mask & table.where(method=method)) for method in methods}
    first = by_method[methods[0]]
    differences = []
    for other in methods[1:]:
        shared = sorted(first.keys() & by_method[other].keys())
        sources = np.array([source for source, _ in shared], object)
        frames = np.array([first[key] - by_method[other][key] for key in shared], float)
        mean = cluster_mean(frames, sources)
        differences.append(WaitDifference(methods[0], other, len(shared), len(set(sources)), mean))
    return differences
