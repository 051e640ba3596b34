"""Reliability of the stated risk: the probability that a map is wrong, compared with the share of false maps.

A method that states a risk of 0.002 is reliable if one in 500 of such maps is false. The maps are therefore counted in
bins of their stated risk (:data:`RISK_EDGES`). The expected number of false maps of a bin is the sum of the stated
risks of its maps.

A method also states standard deviations of the pair of its map, for the rotation and for the direction of the baseline.
The *coverage* is the share of the maps whose pair has an error within 2.80 standard deviations of the rotation, or
within 2.45 of the direction. With exact standard deviations it is 95 % or more: 95 % if the error is equally uncertain
about all axes, and more otherwise, because a stated deviation is that of the most uncertain axis.

Only maps of sequences with a sound ground truth are counted. Maps of a camera that does not translate are counted in
the bins, because a stated risk includes this cause. They have no true direction, so they have no coverage.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slam_init.compare.statistics import Interval, wilson
from slam_init.compare.trial_table import TrialTable

#: Edges of the bins of the stated risk. A bin holds its upper edge, because a map is accepted up to and with a risk of
#: 0.005. The first bin also holds 0.
RISK_EDGES = (0.0, 0.001, 0.002, 0.005, 0.05, 1.0)
#: A Gaussian error lies within this number of standard deviations with a probability of 95 %: square roots of the 95th
#: percentiles of chi-square with two degrees of freedom (direction) and with three (rotation).
DIRECTION_SIGMAS, ROTATION_SIGMAS = 2.45, 2.80


@dataclass(frozen=True)
class RiskBin:
    """The maps with a stated risk in a range."""

    #: low, high: The range: above ``low`` and at most ``high``. A ``low`` of 0 belongs to the range.
    low: float
    high: float
    #: Number of maps.
    maps: int
    #: Mean of the stated risks; NaN without maps.
    mean_risk: float
    #: Expected number of false maps: the sum of the stated risks.
    expected_false: float
    #: Number of false maps.
    false: int
    #: False maps as a share of the maps, with Wilson's interval.
    false_rate: Interval


@dataclass(frozen=True)
class Coverage:
    """The maps whose error lies within the stated standard deviations."""

    #: Number of maps with a stated standard deviation and a known error.
    maps: int
    #: Number of these maps whose error lies within the bound.
    within: int
    #: Their share, with Wilson's interval.
    rate: Interval


@dataclass(frozen=True)
class Reliability:
    """Reliability of the risk and of the standard deviations that a method states."""

    #: One for each range of :data:`RISK_EDGES`.
    bins: tuple[RiskBin, ...]
    #: All maps.
    total: RiskBin
    #: rotation, direction: Coverage of 2.80 standard deviations of the rotation, and of 2.45 of the direction of the
    #: baseline.
    rotation: Coverage
    direction: Coverage

    def named_bins(self) -> list[tuple[str, RiskBin]]:
        """Return the bins with maps and all maps, each with its name in a table."""
        return [*((f"{one.low:g} to {one.high:g}", one) for one in self.bins if one.maps), ("all", self.total)]


def reliability_of(table: TrialTable) -> Reliability | None:
    """Compare the stated risks with the outcomes: of the maps with a stated risk and a sound ground truth."""
    outcome = table["outcome"]
    judged = (outcome == "correct") | (outcome == "false")
    table = table.select(judged & table["sound"] & np.isfinite(table["risk"]))
    if not len(table):
        return None
    position = np.digitize(table["risk"], RISK_EDGES[1:-1], right=True)
    bins = [_bin(table.select(position == k), low, high) for k, (low, high) in enumerate(pairwise(RISK_EDGES))]
    solvable = table.select(table["solvable"])
    return Reliability(
        bins=tuple(bins),
        total=_bin(table, RISK_EDGES[0], RISK_EDGES[-1]),
        rotation=_coverage(solvable, "rotation", ROTATION_SIGMAS),
        direction=_coverage(solvable, "direction", DIRECTION_SIGMAS),
    )


def reliabilities(table: TrialTable, methods: Sequence[str]) -> dict[str, dict[str, Reliability]]:
    """Compare the stated risks of each method with its outcomes, separately for images and for points.

    * Returns: By level (:meth:`TrialTable.levels`) and method. Trials with and without translation are counted
      together. A method without a counted map is left out, and so is a level without a method.
    """
    found = {
        name: {method: one for method in methods if (one := reliability_of(part.of_method(method))) is not None}
        for name, part in table.levels().items()
    }
    return {name: by_method for name, by_method in found.items() if by_method}


def _bin(table: TrialTable, low: float, high: float) -> RiskBin:
    maps, false = len(table), int(np.sum(table["outcome"] == "false"))
    expected = math.fsum(table["risk"].tolist())
    return RiskBin(low, high, maps, expected / maps if maps else math.nan, expected, false, wilson(false, maps))


def _coverage(table: TrialTable, name: str, sigmas: float) -> Coverage:
    error, sigma = table[f"pair_{name}_error_deg"], table[f"{name}_sigma_deg"]
    known = np.isfinite(error) & np.isfinite(sigma)
    maps, within = int(known.sum()), int(np.sum(error[known] <= sigmas * sigma[known]))
    return Coverage(maps, within, wilson(within, maps))
