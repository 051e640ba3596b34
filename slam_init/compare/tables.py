"""Tables of a comparison, in HTML for the report and in Markdown for the terminal: their columns, cells and frame."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from html import escape
from importlib.resources import files
from string import Template
from typing import NamedTuple

from slam_init.compare.figures import Figures, PairTest, WaitDifference
from slam_init.compare.judging import Criteria
from slam_init.compare.reliability import DIRECTION_SIGMAS, ROTATION_SIGMAS, Coverage, Reliability
from slam_init.compare.statistics import Interval
from slam_init.methods.external_command import method_label
from slam_init.output.tables import fitted_tables

#: The ends of an interval behind its value.
TEXT_ENDS, HTML_ENDS = " [{}, {}]", '<span class="interval">{} to {}</span>'
#: A difference of two methods is coloured if its adjusted p-value is smaller.
_SIGNIFICANT = 0.05
_OUTCOMES = ("correct", "accepted", "false", "none", "error")


class Column(NamedTuple):
    """A column of a table of methods."""

    heading: str
    value: Callable[[Figures], Interval | float | int | None]
    #: Digits behind the point, after the figure is multiplied by ``scale``.
    digits: int = 1
    scale: float = 1.0
    #: 1 or -1: the largest or the smallest value is the best. 0: the values are not ranked.
    best: int = 0
    #: Whether the terminal shows the column as well.
    terminal: bool = False
    #: Whether it does so only where a method has a value.
    if_known: bool = False


def _median(name: str) -> Callable[[Figures], float | None]:
    return lambda figures: figures.medians[name]


#: Outcomes and time to the first map, with a moving camera.
RATES = (
    Column("trials", lambda f: f.trials, terminal=True),
    Column("correct %", lambda f: f.correct_rate, 1, 100, best=1, terminal=True),
    Column("strict %", lambda f: f.strict / f.trials if f.trials else None, 1, 100, terminal=True),
    Column("false %", lambda f: f.false_rate, 1, 100, best=-1, terminal=True),
    Column("precision %", lambda f: f.precision, 1, 100),
    Column("audited<br>risk %", lambda f: f.audited_risk, 1, 100, best=-1, terminal=True, if_known=True),
    Column("audit: wrong %", lambda f: f.audited_wrong_rate, 1, 100),
    Column("none", lambda f: f.none, terminal=True),
    Column("ambiguous", lambda f: f.undecided),
    Column("plane: right<br>map kept %", lambda f: f.kept_truth_rate, 1, 100, terminal=True),
    Column("error", lambda f: f.error, terminal=True),
    Column("frames to<br>first map", lambda f: f.frames_to_accept),
    Column("wait<br>(frames)", lambda f: f.wait, 2, best=-1, terminal=True),
    Column("seconds to<br>first map", lambda f: f.seconds_to_accept, 2),
)
#: Quality of the correct maps, time and memory.
QUALITY = (
    Column("rotation<br>(deg)", _median("rotation_error_deg"), 2, best=-1, terminal=True),
    Column("before<br>BA", _median("rotation_error_before_deg"), 2),
    Column("direction<br>(deg)", _median("direction_error_deg"), 2, best=-1, terminal=True),
    Column("before<br>BA", _median("direction_error_before_deg"), 2),
    Column("ATE<br>%", _median("ate"), 2, 100),
    Column("before<br>BA", _median("ate_before"), 2, 100),
    Column("survival<br>%", _median("survival"), 0, 100, best=1, terminal=True),
    Column("depth<br>error %", _median("depth_error"), 1, 100, best=-1),
    Column("depth order<br>error %", _median("depth_order_error"), 1, 100),
    Column("landmarks", _median("landmarks"), 0),
    Column("frame<br>(ms)", lambda f: f.frame_median_ms, terminal=True),
    Column("p95<br>(ms)", lambda f: f.frame_p95_ms),
    Column("attempt<br>(ms)", lambda f: f.attempt_median_ms),
    Column("peak<br>(MB)", lambda f: f.peak_memory_mb, 0),
)
#: Outcomes without translation: static or rotation-only camera.
STATIC = (
    Column("trials", lambda f: f.trials, terminal=True),
    Column("false", lambda f: f.false),
    Column("false %", lambda f: f.false_rate, 1, 100, best=-1, terminal=True),
    Column("audited<br>risk %", lambda f: f.audited_risk, 1, 100, best=-1, terminal=True, if_known=True),
    Column("audit: wrong %", lambda f: f.audited_wrong_rate, 1, 100),
    Column("none", lambda f: f.none, terminal=True),
    Column("error", lambda f: f.error, terminal=True),
    Column("expected reason %", lambda f: f.reason_accuracy, 1, 100, best=1, terminal=True),
    Column("focal error<br>suspected %", lambda f: f.suspicion_rate, 1, 100, terminal=True),
    Column("focal error<br>reported %", lambda f: f.report_rate, 1, 100, terminal=True),
    Column("focal error<br>false alarm %", lambda f: f.false_report_rate, 1, 100),
    Column("frame (ms)", lambda f: f.frame_median_ms),
)


def figure_text(
    value: Interval | float | int | None, digits: int = 1, scale: float = 1.0, *, ends: str = TEXT_ENDS
) -> str:
    """Write a figure; an interval with its ends where they are known, ``-`` for a figure that is not known."""
    if isinstance(value, int):
        return str(value)
    first, *others = value if isinstance(value, Interval) else (value,)
    if first is None or math.isnan(first):
        return "-"
    known = [f"{scale * end:.{digits}f}" for end in others if not math.isnan(end)]
    return f"{scale * first:.{digits}f}{ends.format(*known) if known else ''}"


def html_figure(value: Interval | float | int | None, digits: int = 1, scale: float = 1.0) -> str:
    """Write a figure for a cell of a page."""
    return figure_text(value, digits, scale, ends=HTML_ENDS)


def p_value_text(p: float) -> str:
    """Write a p-value."""
    return "< 0.001" if p < 1e-3 else f"{p:.2g}"


def text_figures(title: str, figures: Mapping[str, Figures], columns: Iterable[Column]) -> str:
    """Make the Markdown tables of the columns that the terminal shows."""
    shown = [
        column
        for column in columns
        if column.terminal and not (column.if_known and all(column.value(f) is None for f in figures.values()))
    ]
    header = [title, *(column.heading.replace("<br>", " ") for column in shown)]
    rows = [
        [method, *(figure_text(column.value(f), column.digits, column.scale) for column in shown)]
        for method, f in figures.items()
    ]
    return fitted_tables(header, rows)


def html_figures(caption: str, figures: Mapping[str, Figures], columns: Sequence[Column], *, bar: bool = False) -> str:
    """Make the HTML table of all columns of which a method has a value, with the best values marked.

    * ``bar``: Whether the outcomes are shown as a bar beside the method.
    """
    columns = [column for column in columns if any(figure_text(column.value(f)) != "-" for f in figures.values())]
    best = [_best_methods(figures, column) for column in columns]
    rows = []
    for i, (method, f) in enumerate(figures.items()):
        cells = [f"<td>{_outcome_bar(f)}</td>"] if bar else []
        for column, winners in zip(columns, best, strict=True):
            text = figure_text(column.value(f), column.digits, column.scale, ends=HTML_ENDS)
            cells.append(f"<td{' class=best' if method in winners else ''}>{text}</td>")
        ours = ' class="ours"' if i == 0 else ""
        rows.append(f"<tr{ours}>{row_heading(method_label(method))}{''.join(cells)}</tr>")
    headings = ["method", *(["outcomes"] if bar else []), *(column.heading for column in columns)]
    return html_table(caption, headings, rows)


def html_table(caption: str, headings: Iterable[str], rows: Iterable[str], kind: str = "") -> str:
    """Make the frame of a table: a caption for screen readers, the scope of each heading, a box that scrolls."""
    head = "".join(f'<th scope="col">{heading}</th>' for heading in headings)
    of_kind = f' class="{kind}"' if kind else ""
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table{of_kind}>'
        f"<caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def row_heading(text: str, rows: int = 1) -> str:
    """Make the heading of a row, or of several rows."""
    span = f' rowspan="{rows}"' if rows > 1 else ""
    return f'<th scope="row{"group" if rows > 1 else ""}"{span}>{escape(text)}</th>'


def share_bar(pieces: Sequence[tuple[str, int]]) -> str:
    """Draw a stacked bar of shares for a cell of a table: CSS class and count of each piece."""
    total = sum(count for _, count in pieces) or 1
    words = ", ".join(f"{count} {name}" for name, count in pieces if count)
    spans = "".join(
        f'<span class="{name}" style="width:{100 * count / total:.2f}%"></span>' for name, count in pieces if count
    )
    return f'<div class="shares" title="{escape(words)}" role="img" aria-label="{escape(words)}">{spans}</div>'


def _outcome_bar(f: Figures) -> str:
    not_compared = f.accepted - f.correct - f.false
    counts = (f.strict, f.correct - f.strict, not_compared, f.false, f.none, f.error)
    return share_bar(list(zip(("strict", "correct", "accepted", "false", "none", "error"), counts, strict=True)))


def _best_methods(figures: Mapping[str, Figures], column: Column) -> set[str]:
    """Return the methods that are best in a column; empty if all are equal, or if the column is not ranked."""
    values = {}
    for method, f in figures.items():
        value = column.value(f)
        rank = value.value if isinstance(value, Interval) else value
        if rank is not None and not math.isnan(rank):
            values[method] = column.best * rank
    if not column.best or len(set(values.values())) < 2:
        return set()
    return {method for method, value in values.items() if value == max(values.values())}


def page_part(part: str, /, **values: object) -> str:
    """Fill a part of ``report.html``. There a comment names each part."""
    return _page_parts()[part].substitute(values)


@cache
def _page_parts() -> dict[str, Template]:
    text = files("slam_init.compare").joinpath("report.html").read_text(encoding="utf-8")
    # A line break before a block or a placeholder is none of the page; one in a text is a space.
    text = re.sub(r"\n(?=\$|</?(h\d|p|div|nav|footer)\b)", "", text).replace("\n", " ")
    _, *parts = re.split(r"<!-- (\w+) -->", text)
    return {name: Template(part.strip()) for name, part in zip(parts[::2], parts[1::2], strict=True)}


def page_html(title: str, body: Iterable[str]) -> str:
    """Make a page that loads nothing from other places."""
    home = files("slam_init.compare")
    css, script = (home.joinpath(f"report.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{css}</style></head><body><main>{''.join(body)}</main>"
        f"<script>{script}</script></body></html>\n"
    )


def group_table(
    groups: Mapping[str, Mapping[str, Figures]], methods: Sequence[str], thumbnails: Mapping[str, str]
) -> str:
    """Make the table of scenes (rows) and methods (columns) with counts of correct, false and no maps, and the wait."""
    rows = []
    for group, figures in groups.items():
        cells = []
        for f in figures.values():
            counts = f"{f.accepted - f.false} / {f.false} / {f.none + f.error}"
            not_compared = f.accepted - f.correct - f.false
            bar = share_bar(list(zip(_OUTCOMES, (f.correct, not_compared, f.false, f.none, f.error), strict=True)))
            wait = "" if math.isnan(f.wait.value) else f'<span class="interval">wait {f.wait.value:.2f}</span>'
            cells.append(f"<td>{bar}{counts}{wait}</td>")
        picture = ""
        if group in thumbnails:
            picture = f'<img class="thumb" alt="" src="data:image/jpeg;base64,{thumbnails[group]}">'
        rows.append(f'<tr><th scope="row">{picture}{escape(group)}</th>{"".join(cells)}</tr>')
    headings = ["scene", *(escape(method_label(method)) for method in methods)]
    return html_table("outcomes by scene and method", headings, rows, "matrix")


def wait_table(differences: Sequence[WaitDifference]) -> str:
    """Make the table of the waits of the first method compared with those of each other method."""
    if not differences:
        return ""
    first = method_label(differences[0].first)
    rows = [
        f"<tr>{row_heading(method_label(d.second))}<td>{d.trials}</td><td>{d.sequences}</td>"
        f"<td{_sign_class(d.difference_frames)}>{html_figure(d.difference_frames, 2)}</td></tr>"
        for d in differences
    ]
    headings = [f"wait of {escape(first)} minus that of", "trials", "sequences", "frames"]
    return html_table(f"wait of {first} minus that of each other method", headings, rows)


def _sign_class(difference: Interval) -> str:
    """Return the colour of a difference whose interval does not hold zero. A shorter wait is better."""
    return ' class="win"' if difference.high < 0 else ' class="lose"' if difference.low > 0 else ""


def risk_table(by_method: Mapping[str, Reliability]) -> str:
    """Make the table of the stated risks: for each method a row for each bin with maps, and a row for all maps."""
    rows = []
    for method, reliability in by_method.items():
        named = reliability.named_bins()
        for k, (name, one) in enumerate(named):
            head = row_heading(method_label(method), len(named)) if k == 0 else ""
            understated = ' class="lose"' if one.false_rate.low > one.mean_risk else ""
            rows.append(
                f"<tr>{head}<td>{name}</td><td>{one.maps}</td><td>{html_figure(one.mean_risk, 3, 100)}</td>"
                f"<td>{html_figure(one.expected_false, 3)}</td><td>{one.false}</td>"
                f"<td{understated}>{html_figure(one.false_rate, 2, 100)}</td></tr>"
            )
    headings = ["method", "stated risk", "maps", "mean stated<br>risk %", "expected<br>false maps"]
    return html_table("stated risks and false maps", [*headings, "false maps", "false %"], rows)


def coverage_table(by_method: Mapping[str, Reliability]) -> str:
    """Make the table of the coverage of the stated standard deviations."""
    rows = [
        f"<tr>{row_heading(method_label(method))}{_coverage_cells(one.direction)}{_coverage_cells(one.rotation)}</tr>"
        for method, one in by_method.items()
    ]
    headings = ["method", "maps", f"direction within<br>{DIRECTION_SIGMAS:.2f} deviations %"]
    headings += ["maps", f"rotation within<br>{ROTATION_SIGMAS:.2f} deviations %"]
    return html_table("coverage of the stated standard deviations", headings, rows)


def _coverage_cells(coverage: Coverage) -> str:
    return f"<td>{coverage.maps}</td><td>{html_figure(coverage.rate, 1, 100)}</td>"


def judging_table(judging: Mapping[str, Criteria]) -> str:
    """Make the table of how each sequence is judged."""
    rows = [
        f"<tr>{row_heading(group)}<td>{criteria.truth}</td><td>{escape(criteria.rule)}</td>"
        f"<td>{criteria.expected_reason or '-'}</td><td>{escape(criteria.note or '-')}</td></tr>"
        for group, criteria in judging.items()
    ]
    headings = ["scene", "ground truth", "correct", "expected reason", "because"]
    return html_table("how each sequence is judged", headings, rows, "words")


def pair_table(pairs: Iterable[PairTest], methods: Sequence[str]) -> str:
    """Make the table of paired comparisons: p-values, and trials that only one of two methods solves."""
    tests = {(test.first, test.second): test for test in pairs}
    rows = []
    for first in methods:
        cells = ["<td>&middot;</td>" if first == second else _pair_cell(tests, first, second) for second in methods]
        rows.append(f"<tr>{row_heading(method_label(first))}{''.join(cells)}</tr>")
    headings = ["only row : only column", *(escape(method_label(method)) for method in methods)]
    return html_table("trials that only one of two methods solves", headings, rows, "matrix")


def _pair_cell(tests: Mapping[tuple[str, str], PairTest], of_row: str, of_column: str) -> str:
    test = tests.get((of_row, of_column)) or tests[of_column, of_row]
    row, column = test.only_first_correct, test.only_second_correct
    if test.first != of_row:
        row, column = column, row
    p = test.p_correct_holm
    kind = "" if p >= _SIGNIFICANT else ' class="win"' if row > column else ' class="lose"'
    p_value = f"p {'' if p < 1e-3 else '= '}{p_value_text(p)}"
    return f'<td{kind}>{row} : {column}<span class="interval">{escape(p_value)}</span></td>'
