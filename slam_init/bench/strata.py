"""Difficulty strata: the kind of the scene, crossed with what makes a world difficult.

A stratum is a value of one axis within one kind of scene, for example a baseline of 0.03 of the depth on a plane.
Worlds have all axes; a public sequence has its kind only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import parse_qsl

import numpy as np

from slam_init.bench.manifest import kind_of_sequence
from slam_init.compare.judging import criteria_of
from slam_init.compare.sources import ComparedSource
from slam_init.compare.statistics import Interval, cluster_share
from slam_init.compare.trial_table import TrialTable

#: Options of a world that are strata, and their headings.
AXES = {"baseline": "baseline / depth", "noise_px": "noise (px)", "outliers": "outliers", "focal_error": "focal error"}
_PLANES = ("wall", "nadir", "tilted", "handheld-wall")


@dataclass(frozen=True)
class Cell:
    """A method in a stratum."""

    method: str
    trials: int
    #: Share of the trials with a correct map. NaN if no map can be correct.
    correct: Interval
    #: Number of false maps.
    false: int


@dataclass(frozen=True)
class Stratum:
    """Trials of equal difficulty."""

    #: Kind of the scene.
    kind: str
    #: A name of :data:`AXES`; empty for all trials of the kind.
    axis: str
    #: Value on the axis; None for all trials of the kind.
    value: float | None
    #: One for each method.
    cells: tuple[Cell, ...]


def strata_of(table: TrialTable, sources: Sequence[ComparedSource], methods: Sequence[str]) -> list[Stratum]:
    """Count the trials of each stratum.

    * Returns: For each kind, all its trials first, then the values of each axis. Empty strata are left out.
    """
    kinds = {source.label: _kind(source) for source in sources}
    values = {source.label: _values(source) for source in sources}
    labels = table["source"].tolist()
    kind_of_row = np.array([kinds[label] for label in labels], object)
    axes = {axis: np.array([values[label].get(axis, np.nan) for label in labels], float) for axis in AXES}
    strata = []
    for kind in sorted(set(kinds.values())):
        of_kind = kind_of_row == kind
        strata.append(Stratum(kind, "", None, _cells(table.select(of_kind), methods)))
        for axis, of_row in axes.items():
            for value in sorted(set(of_row[of_kind & np.isfinite(of_row)].tolist())):
                cells = _cells(table.select(of_kind & (of_row == value)), methods)
                strata.append(Stratum(kind, axis, value, cells))
    return strata


def _cells(table: TrialTable, methods: Sequence[str]) -> tuple[Cell, ...]:
    cells = []
    for method in methods:
        trials = table.of_method(method)
        solvable = trials.select(trials["solvable"])
        correct = cluster_share(solvable["outcome"] == "correct", solvable["source"])
        cells.append(Cell(method, len(trials), correct, int(np.sum(trials["outcome"] == "false"))))
    return tuple(cells)


def _kind(source: ComparedSource) -> str:
    prefix, colon, name = source.label.partition("?")[0].partition(":")
    if not colon or prefix not in ("points", "synth"):
        return kind_of_sequence(source.label)
    if criteria_of(source.group).no_translation:
        return "no translation"
    return "plane" if name.startswith(_PLANES) else "general"


def _values(source: ComparedSource) -> dict[str, float]:
    if not source.label.startswith("points:"):
        return {}
    return {name: float(value) for name, value in parse_qsl(source.label.partition("?")[2]) if name in AXES}
