"""The score sheet of a run. Two runs of the same command differ in the fields ``times`` and ``machine`` only."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from urllib.parse import parse_qsl, unquote

import numpy as np

from slam_init.bench.manifest import kind_of_sequence
from slam_init.bench.protocol import NAME, VERSION, FrozenCheck, Run, check_frozen
from slam_init.compare.figures import figures_of, only_counts, paired_outcomes
from slam_init.compare.judging import criteria_of
from slam_init.compare.plan import Plan
from slam_init.compare.reliability import RiskBin, reliability_of
from slam_init.compare.sources import ComparedSource
from slam_init.compare.statistics import Interval, cluster_share, holm, sign_flip
from slam_init.compare.trial_table import TrialTable
from slam_init.methods.external_command import is_external, method_label
from slam_init.methods.registry import method_info
from slam_init.output.plain_json import Json, plain_fields
from slam_init.output.provenance import hardware, versions
from slam_init.types.arrays import Bools

#: Options of a drawn world that are strata, and their headings. Another generator has factors of its own.
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
    #: A name of :data:`AXES`, or of a factor of another generator; empty for all trials of the kind.
    axis: str
    #: Value on the axis, of another generator as it names it; None for all trials of the kind.
    value: float | str | None
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
    names = dict.fromkeys(chain(AXES, *values.values()))
    axes = {axis: np.array([values[label].get(axis) for label in labels], object) for axis in names}
    strata = []
    for kind in sorted(set(kinds.values())):
        of_kind = kind_of_row == kind
        strata.append(Stratum(kind, "", None, _cells(table.select(of_kind), methods)))
        for axis, of_row in axes.items():
            for value in sorted(set(of_row[of_kind].tolist()) - {None}):
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
    generator, slash, _ = name.partition("/")
    if slash:  # the worlds of another generator, whose scenes have other names
        return unquote(generator)
    return "plane" if name.startswith(_PLANES) else "general"


def _values(source: ComparedSource) -> dict[str, float | str]:
    name, _, query = source.label.partition("?")
    if not name.startswith("points:"):
        return {}
    if "/" in name:
        return dict(parse_qsl(query))
    return {axis: float(value) for axis, value in parse_qsl(query) if axis in AXES}


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
    #: Whether the share of false maps agrees with the stated risks: its 95 % interval holds the mean stated risk, or
    #: lies below.
    reliable: bool


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
    #: By method.
    times: Mapping[str, Times]
    machine: Mapping[str, str]
    packages: Mapping[str, str]

    @property
    def title(self) -> str:
        """Return the name of the benchmark, its version and the suite."""
        return f"{NAME} {VERSION}, suite {self.run.suite}"

    def as_dict(self) -> dict[str, Json]:
        """Convert to plain JSON types, as in ``sheet.json``.

        * Returns: An interval becomes a list of value, low and high end, with six significant digits and None for NaN.
        """
        head: dict[str, Json] = {"schema": SCHEMA, "benchmark": NAME, "version": VERSION, "suite": self.run.suite}
        return head | plain_fields(self)


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
        times={method: _times(table.of_method(method)) for method in plan.methods},
        machine=hardware(),
        packages=versions(),
    )


def _row(table: TrialTable, run: Run, method: str, not_applicable: int) -> Row:
    trials = table.of_method(method)
    solvable, judged = trials.select(trials["solvable"]), trials.select(trials["outcome"] != "accepted")
    expected = trials.select(trials["reason_expected"])
    figures, reliability = figures_of(trials), reliability_of(trials)
    info = method_info(method)
    about = "an external program" if is_external(method) else info.summary
    return Row(
        method=method,
        label=method_label(method),
        about=about,
        trials=len(trials),
        sequences=len(set(trials["source"].tolist())),
        solvable=len(solvable),
        correct=_share(solvable["outcome"] == "correct", solvable),
        strict=_share(solvable["strict"] & (solvable["outcome"] == "correct"), solvable),
        false=_share(judged["outcome"] == "false", judged),
        false_maps=figures.false,
        none=_share(solvable["outcome"] == "none", solvable),
        errors=figures.error,
        delay=figures.wait,
        reason=_share(expected["reason_right"], expected),
        risk=None if reliability is None else _risk(reliability.total),
        not_applicable=not_applicable,
        command=shlex.join(run.words((method,))),
    )


def _times(table: TrialTable) -> Times:
    figures = figures_of(table)
    return Times(figures.frame_median_ms, figures.frame_p95_ms, figures.attempt_median_ms)


def _risk(maps: RiskBin) -> Risk:
    reliable = maps.false_rate.low <= maps.mean_risk
    return Risk(maps.maps, maps.expected_false, maps.false, maps.false_rate, reliable)


def _share(hits: Bools, table: TrialTable) -> Interval:
    return cluster_share(hits, table["source"])


def _pairs(table: TrialTable, methods: Sequence[str]) -> list[PairedTest]:
    """Test each pair of methods on the trials that both ran."""
    pairs = paired_outcomes(table, methods)
    p_correct, p_false = (
        holm([sign_flip(getattr(pair, kind).astype(float), pair.sources) for pair in pairs])
        for kind in ("correct", "false")
    )
    return [
        PairedTest(
            method_label(pair.first),
            method_label(pair.second),
            len(pair.sources),
            *only_counts(pair.correct),
            *only_counts(pair.false),
            correct,
            false,
        )
        for pair, correct, false in zip(pairs, p_correct, p_false, strict=True)
    ]
