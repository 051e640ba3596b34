"""The score sheet of a run. Two runs of the same command differ in the fields ``times`` and ``machine`` only."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations

import numpy as np

from slam_init.bench.frozen import FrozenCheck, check_frozen
from slam_init.bench.hardware import hardware, versions
from slam_init.bench.protocol import NAME, VERSION, Run
from slam_init.bench.strata import Stratum, strata_of
from slam_init.compare.aggregate import figures_of
from slam_init.compare.plan import Plan
from slam_init.compare.reliability import reliability_of
from slam_init.compare.statistics import Interval, cluster_share, holm, sign_flip
from slam_init.compare.summary import six_digits
from slam_init.compare.trial_table import TrialTable
from slam_init.compare.wait import mean_wait
from slam_init.methods.external_command import is_external, method_label
from slam_init.methods.registry import method_info
from slam_init.output.plain_json import Json
from slam_init.types.arrays import Bools

#: Version of the layout of ``sheet.json``.
SCHEMA = 1


@dataclass(frozen=True)
class Risk:
    """The stated risks of the maps of a method, compared with the outcomes."""

    #: Number of maps with a stated risk and a sound ground truth.
    maps: int
    #: Sum of their stated risks.
    expected_false: float
    #: Number of false maps among them.
    false: int
    false_rate: Interval

    @property
    def reliable(self) -> bool:
        """Return whether the share of false maps agrees with the stated risks.

        * Returns: True if the 95 % interval of the share holds the mean stated risk, or lies below.
        """
        return self.false_rate.low <= self.expected_false / self.maps


@dataclass(frozen=True)
class Times:
    """Times in milliseconds, of one core of the machine of the run; None if nothing was timed."""

    #: frame_ms, frame_p95_ms, attempt_ms: Median and 95th percentile of a frame, median of a frame with an attempt.
    frame_ms: float | None
    frame_p95_ms: float | None
    attempt_ms: float | None


@dataclass(frozen=True)
class Row:
    """The scores of a method."""

    #: As on the command line.
    method: str
    #: Name in tables.
    label: str
    #: What the method is, in one line, and its source.
    about: str
    #: trials, sequences: Number of trials, and of worlds or sequences.
    trials: int
    sequences: int
    #: Number of trials in which a map can be correct.
    solvable: int
    #: Share of the solvable trials with a correct map.
    correct: Interval
    #: Share of the solvable trials with a map within 1 degree in rotation and 5 in direction.
    strict: Interval
    #: Share of all judged trials with a false map.
    false: Interval
    #: Their number.
    false_maps: int
    #: Share of the solvable trials without a map.
    none: Interval
    #: Number of trials that ended in an error.
    errors: int
    #: Frames after the start until the first correct map: restricted mean over the solvable trials.
    delay: Interval
    #: Of the trials without translation, the share that ended with the expected reason.
    reason: Interval
    #: None for a method that states no risk.
    risk: Risk | None
    #: Number of sources on which the method cannot run.
    not_applicable: int
    #: A command line that gives this row alone.
    command: str
    times: Times


@dataclass(frozen=True)
class PairedTest:
    """Two methods on the same trials."""

    #: first, second: Labels of the methods.
    first: str
    second: str
    #: Number of trials that both ran.
    trials: int
    #: only_first_correct, only_second_correct, only_first_false, only_second_false: Number of trials in which only
    #: this method has a correct map, or a false map.
    only_first_correct: int
    only_second_correct: int
    only_first_false: int
    only_second_false: int
    #: p_correct, p_false: Of a sign-flip test by sequence, adjusted for the number of pairs (Holm). Where each world
    #: has one trial it is McNemar's test.
    p_correct: float
    p_false: float


@dataclass(frozen=True)
class Sheet:
    """The score sheet of a run."""

    run: Run
    #: The command line of the run.
    command: str
    #: In which options the run departs from the protocol.
    departures: tuple[str, ...]
    #: Labels of the sources.
    sequences: tuple[str, ...]
    frozen: FrozenCheck
    #: Missing sequences, methods that cannot run.
    notes: tuple[str, ...]
    rows: tuple[Row, ...]
    pairs: tuple[PairedTest, ...]
    strata: tuple[Stratum, ...]
    machine: Mapping[str, str]
    packages: Mapping[str, str]

    @property
    def title(self) -> str:
        """Return the name of the benchmark, its version and the suite."""
        return f"{NAME} {VERSION}, suite {self.run.suite}"

    def as_dict(self) -> dict[str, Json]:
        """Convert to plain JSON types, as in ``sheet.json``.

        * Returns: An interval becomes a list of value, low and high end, with six significant digits and None for NaN.
          Times are in ``times`` by method, apart from the rows.
        """
        rows = [{name: _plain(value) for name, value in vars(row).items() if name != "times"} for row in self.rows]
        return {
            "schema": SCHEMA,
            "benchmark": NAME,
            "version": VERSION,
            "suite": self.run.suite,
            "run": _plain(asdict(self.run)),
            "command": self.command,
            "departures": list(self.departures),
            "sequences": list(self.sequences),
            "frozen": _plain(vars(self.frozen)),
            "notes": list(self.notes),
            "rows": list(rows),
            "pairs": [_plain(vars(pair)) for pair in self.pairs],
            "strata": [
                _plain({**vars(one), "cells": [{**vars(cell)} for cell in one.cells]}) for one in self.strata
            ],
            "times": {row.method: _plain(vars(row.times)) for row in self.rows},
            "machine": _plain(self.machine),
            "packages": _plain(self.packages),
        }  # fmt: skip


def sheet_of(table: TrialTable, plan: Plan, run: Run, digests: Mapping[str, str], notes: Sequence[str]) -> Sheet:
    """Compute the score sheet of a run."""
    left_out = plan.not_applicable()
    known = {source.label: digests.get(source.label, "") for source in plan.sources}
    return Sheet(
        run=run,
        command=shlex.join(run.words()),
        departures=tuple(run.departures()),
        sequences=tuple(known),
        frozen=check_frozen(run.suite, known),
        notes=tuple(notes),
        rows=tuple(_row(table, run, method, left_out.get(method, 0)) for method in plan.methods),
        pairs=tuple(_pairs(table, plan.methods)),
        strata=tuple(strata_of(table, plan.sources, plan.methods)),
        machine=hardware(),
        packages=versions(),
    )


def _row(table: TrialTable, run: Run, method: str, not_applicable: int) -> Row:
    mask = table.where(method=method)
    outcome, sources = table.text["outcome"], table.text["source"]
    solvable, judged = mask & table.solvable, mask & (outcome != "accepted")
    figures, reliability = figures_of(table, mask), reliability_of(table, mask)
    info = method_info(method)
    about = "an external program" if is_external(method) else f"{info.summary} ({info.source})"
    total = None if reliability is None else reliability.total
    return Row(
        method=method,
        label=method_label(method),
        about=about,
        trials=int(mask.sum()),
        sequences=len(set(sources[mask].tolist())),
        solvable=int(solvable.sum()),
        correct=_share(outcome == "correct", solvable, table),
        strict=_share(table.strict & (outcome == "correct"), solvable, table),
        false=_share(outcome == "false", judged, table),
        false_maps=int(np.sum(judged & (outcome == "false"))),
        none=_share(outcome == "none", solvable, table),
        errors=int(np.sum(mask & (outcome == "error"))),
        delay=mean_wait(table, mask),
        reason=_share(table.reason_right, mask & table.reason_expected, table),
        risk=None if total is None else Risk(total.maps, total.expected_false, total.false, total.false_rate),
        not_applicable=not_applicable,
        command=shlex.join(run.words((method,))),
        times=Times(
            figures.times["frame_median_ms"], figures.times["frame_p95_ms"], figures.times["attempt_median_ms"]
        ),
    )


def _share(hits: Bools, mask: Bools, table: TrialTable) -> Interval:
    return cluster_share(hits[mask], table.text["source"][mask])


def _pairs(table: TrialTable, methods: Sequence[str]) -> list[PairedTest]:
    """Test each pair of methods on the trials that both ran."""
    by_method = {method: _outcomes(table, method) for method in methods}
    found = []
    for first, second in combinations(methods, 2):
        shared = sorted(by_method[first].keys() & by_method[second].keys())
        clusters = np.array([source for source, _ in shared], object)
        counts: list[int] = []
        p_values: list[float] = []
        for outcome in ("correct", "false"):
            one, other = (np.array([by_method[m][key] == outcome for key in shared], bool) for m in (first, second))
            counts += [int(np.sum(one & ~other)), int(np.sum(other & ~one))]
            p_values.append(sign_flip(one.astype(float) - other.astype(float), clusters))
        found.append((first, second, len(shared), counts, p_values))
    p_correct, p_false = (holm([values[i] for *_, values in found]) for i in (0, 1))
    return [
        PairedTest(
            method_label(first),
            method_label(second),
            trials,
            counts[0],
            counts[1],
            counts[2],
            counts[3],
            p_correct[i],
            p_false[i],
        )
        for i, (first, second, trials, counts, _) in enumerate(found)
    ]


def _outcomes(table: TrialTable, method: str) -> dict[tuple[str, int], str]:
    mask = table.where(method=method)
    sources, starts = table.text["source"][mask].tolist(), table.numbers["start"][mask].astype(int).tolist()
    return dict(zip(zip(sources, starts, strict=True), table.text["outcome"][mask].tolist(), strict=True))


def _plain(value: object) -> Json:
    if isinstance(value, Interval):
        return [six_digits(value.value), six_digits(value.low), six_digits(value.high)]
    if isinstance(value, Risk):
        return {name: _plain(item) for name, item in vars(value).items()} | {"reliable": value.reliable}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return six_digits(value) if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    raise TypeError(f"{type(value).__name__} has no JSON type")
