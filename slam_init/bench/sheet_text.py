"""The score sheet as Markdown. The columns of times end in ``(ms)``; all else is the same in a second run."""

from __future__ import annotations

from collections.abc import Sequence

from slam_init.bench.sheet import AXES, PairedTest, Row, Sheet, Stratum
from slam_init.compare.tables import figure_text, p_value_text
from slam_init.methods.external_command import method_label
from slam_init.output.tables import fitted_tables

#: Pairs with a larger adjusted p-value are not listed one by one.
_SIGNIFICANT = 0.05


def sheet_text(sheet: Sheet) -> str:
    """Write a score sheet."""
    first = sheet.rows[0]
    parts = [
        f"# {sheet.title}",
        f"    {sheet.command}",
        "\n".join(f"* {line}" for line in _facts(sheet)),
        "## Scores",
        "Shares in %, with 95 % intervals. Correct, none and delay are over the trials in which a map can be correct "
        f"({first.solvable} of {first.trials}). False is over all trials: a camera that does not translate has no "
        "correct map. Delay: frames after the start until the first correct map; a trial without one counts as its "
        "limit. Risk: false maps among those with a stated risk, and how many the stated risks promise.",
        _scores(sheet),
        "## On the same trials",
        _pairs_text(sheet.pairs),
        "## Strata",
        "Correct maps in %, and the number of false maps after the slash.",
        *(_strata(kind, sheet) for kind in dict.fromkeys(stratum.kind for stratum in sheet.strata)),
        "## Commands",
        "\n".join(f"* {row.label}: `{row.command}`" for row in sheet.rows),
        "## Machine",
        "\n".join(f"* {name}: {value}" for name, value in (*sheet.machine.items(), *sheet.packages.items())),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _facts(sheet: Sheet) -> list[str]:
    whole = "the whole suite" if not sheet.departures else f"a part of the suite: {'; '.join(sheet.departures)}"
    return [whole, f"tracks: {sheet.frozen.text}", *sheet.notes]


def _scores(sheet: Sheet) -> str:
    header = ["method", "trials", "correct", "strict", "false", "none", "error", "delay (frames)", "reason right"]
    header += ["risk: false (expected) of maps", "frame (ms)", "p95 (ms)"]
    return fitted_tables(
        header,
        [
            [
                row.label,
                str(row.trials) if row.trials else "not applicable",
                figure_text(row.correct, 1, 100),
                figure_text(row.strict, 1, 100),
                figure_text(row.false, 1, 100),
                figure_text(row.none, 1, 100),
                str(row.errors),
                figure_text(row.delay, 2),
                figure_text(row.reason, 1, 100),
                _risk(row),
                figure_text(sheet.times[row.method].frame_ms),
                figure_text(sheet.times[row.method].frame_p95_ms),
            ]
            for row in sheet.rows
        ],
    )


def _pairs_text(pairs: Sequence[PairedTest]) -> str:
    """List the pairs that differ; tell the number of the others."""
    rows = []
    for pair in pairs:
        for outcome, one, other, p in (
            ("correct", pair.only_first_correct, pair.only_second_correct, pair.p_correct),
            ("false", pair.only_first_false, pair.only_second_false, pair.p_false),
        ):
            if p < _SIGNIFICANT:
                rows.append([f"{pair.first} : {pair.second}", outcome, f"{one} : {other}", p_value_text(p)])
    if not pairs:
        return ""
    counted = (
        f"{2 * len(pairs) - len(rows)} of {2 * len(pairs)} comparisons of two methods show no difference "
        "(sign-flip test by sequence, Holm)."
    )
    if not rows:
        return counted
    header = ["pair", "outcome", "trials in which only one of them has it", "p (Holm)"]
    return f"{counted} The others:\n\n{fitted_tables(header, rows)}"


def _strata(kind: str, sheet: Sheet) -> str:
    strata = [stratum for stratum in sheet.strata if stratum.kind == kind]
    header = [kind, "trials", *(method_label(method) for method in sheet.run.methods)]
    rows = [[_stratum_name(one), str(max(cell.trials for cell in one.cells)), *_cells(one)] for one in strata]
    return fitted_tables(header, rows)


def _stratum_name(stratum: Stratum) -> str:
    if isinstance(stratum.value, float):
        return f"{AXES[stratum.axis]} {stratum.value:g}"
    return "all" if stratum.value is None else f"{AXES.get(stratum.axis, stratum.axis)} {stratum.value}"


def _cells(stratum: Stratum) -> list[str]:
    cells = [(figure_text(cell.correct.value, 0, 100), cell) for cell in stratum.cells]
    return [f"{share} / {cell.false}" if cell.trials else "-" for share, cell in cells]


def _risk(row: Row) -> str:
    if row.risk is None:
        return "-"
    verdict = "" if row.risk.reliable else ", understated"
    return f"{row.risk.false} ({row.risk.expected_false:.2g}) of {row.risk.maps}{verdict}"
