"""``report.html``: a single page that loads nothing from other places. Its script only copies tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from slam_init.compare.charts import Axis, box_chart, curve_chart, interval_chart, stacked_chart
from slam_init.compare.figures import Figures
from slam_init.compare.gallery import thumbnails, waiting_cases, worst_cases
from slam_init.compare.reliability import Reliability
from slam_init.compare.statistics import Interval
from slam_init.compare.summary import ComparisonSummary
from slam_init.compare.tables import (
    QUALITY,
    RATES,
    STATIC,
    coverage_table,
    group_table,
    html_figures,
    judging_table,
    page_html,
    page_part,
    pair_table,
    risk_table,
    wait_table,
)
from slam_init.compare.trial_table import LEVELS, PARTS, TrialTable
from slam_init.methods import METHODS
from slam_init.methods.external_command import method_label
from slam_init.types.arrays import Floats
from slam_init.types.reasons import in_words

if TYPE_CHECKING:
    from slam_init.compare.plan import Plan

#: Number of colours of the page (``report.css``).
_METHOD_COLORS = 22
#: Number of colours of reasons.
_COLORS = 10
#: Ranges of the axes of errors, in degrees.
_ROTATION_DEG, _DIRECTION_DEG = (0.01, 180.0), (0.1, 180.0)
#: Range of the axes of risks.
_RISK_PERCENT = (0.01, 100.0)
_OUTCOMES = ("strict", "correct", "false", "none", "error")


def report_html(table: TrialTable, summary: ComparisonSummary, plan: Plan, command: str) -> str:
    """Make the page."""
    colors = method_colors(plan.methods)
    sections = {
        name: _static_section(name, summary)
        if name.endswith("static")
        else _moving_section(name, part, summary, plan, colors)
        for name, part in table.parts().items()
    }
    body = [
        _header(table, summary, plan, command),
        *sections.values(),
        _reliability_section(summary.reliability, colors) if summary.reliability else "",
        page_part("scenes", table=group_table(summary.groups, plan.methods, thumbnails(plan.sources))),
        page_part("judging", table=judging_table(summary.judging)),
        page_part("worst", cases=worst_cases(table, plan)),
        page_part("waiting", cases=waiting_cases(table, plan)),
        page_part("footer", every=plan.every),
    ]
    return page_html("slam-init compare", body)


def _header(table: TrialTable, summary: ComparisonSummary, plan: Plan, command: str) -> str:
    false = int(np.sum(table["outcome"] == "false"))
    facts = [
        (f"{len(table):,}", "trials"),
        (str(len(plan.methods)), "methods"),
        (f"{len(plan.sources):,}", "sources"),
        (f"{false:,}", "false maps"),
        (str(plan.settings.seed), "seed"),
    ]
    links = [(name, PARTS[name]) for name in summary.parts]
    links += [("reliability", "stated risk")] if summary.reliability else []
    links += [("scenes", "by scene"), ("judging", "how judged"), ("worst", "worst cases"), ("waiting", "no map")]
    return page_part(
        "header",
        limit_frames=plan.settings.limit_frames,
        limit_s=f"{plan.settings.limit_s:g}",
        facts="".join(f"<div><b>{n}</b>{unit}</div>" for n, unit in facts),
        links="".join(f"<a href=#{name}>{escape(title)}</a>" for name, title in links),
        command=f"<pre><code>{escape(command)}</code></pre>" if command else "",
        legend=_legend([(name, name) for name in _OUTCOMES]),
    )


# -- one part --------------------------------------------------------------------------------------


def _moving_section(
    name: str, table: TrialTable, summary: ComparisonSummary, plan: Plan, colors: Mapping[str, str]
) -> str:
    figures = summary.parts[name]
    return page_part(
        "moving",
        name=name,
        title=escape(_capital(PARTS[name])),
        rates=html_figures("outcomes and time by method", figures, RATES, bar=True),
        quality=html_figures("quality of the correct maps, and time, by method", figures, QUALITY),
        legend=_legend([(colors[method], method_label(method)) for method in plan.methods]),
        charts="".join(_charts(table, figures, colors)),
        pairs=pair_table(summary.pairs[name], plan.methods),
        first=escape(method_label(plan.methods[0])),
        waits=wait_table(summary.waits[name]),
    )


def _static_section(name: str, summary: ComparisonSummary) -> str:
    figures = summary.parts[name]
    return page_part(
        "static",
        name=name,
        title=escape(_capital(PARTS[name])),
        outcomes=html_figures("outcomes by method without translation", figures, STATIC, bar=True),
        reasons=_reasons(figures),
    )


def _charts(table: TrialTable, figures: Mapping[str, Figures], colors: Mapping[str, str]) -> list[str]:
    limit = max(float(np.max(table["frames_limit"])), 2.0)
    time = Axis("frames since the start", 0, limit)
    parts = {method: table.of_method(method) for method in colors}
    frames = {
        kind: {method: part["frames_to_accept"][part["outcome"] == kind] for method, part in parts.items()}
        for kind in ("correct", "false")
    }
    correct, false = (
        {colors[method]: _cumulative(values, len(parts[method])) for method, values in frames[kind].items()}
        for kind in ("correct", "false")
    )
    most_false = max((float(y[-1]) for _, y in false.values() if len(y)), default=0.0)
    charts = []
    for name, kind, curves, top in (
        ("Delay: correct maps over time", "correct", correct, 1.0),
        ("False maps over time", "false", false, _above(most_false)),
    ):
        title = _described(f"{kind} maps over time", curves, colors)
        chart = curve_chart(title, curves, time, Axis("share of trials", 0, top), [])
        charts.append(_figure(name, f"Share of the trials that have a {kind} map at this frame.", chart))
    for column, name, (low, high), bounds in (
        ("rotation_error_deg", "Rotation error", _ROTATION_DEG, (1, 5)),
        ("direction_error_deg", "Direction error", _DIRECTION_DEG, (5, 15)),
    ):
        # Trials whose ground truth does not resolve the direction have no direction error.
        judged = {m: part.with_direction() if column == "direction_error_deg" else part for m, part in parts.items()}
        curves = {
            colors[method]: _cumulative(np.clip(_known(part[column]), low, high), len(part))
            for method, part in judged.items()
        }
        note = "Share of the trials whose map has at most this error. Dashed lines: the bounds of strict and correct."
        axis = Axis(f"worst keyframe (degrees), strict {bounds[0]}, correct {bounds[1]}", low, high, log=True)
        chart = curve_chart(_described(name, curves, colors), curves, axis, Axis("share of trials", 0, 1), bounds)
        charts.append(_figure(name, note, chart))
    boxes = [(method_label(method), colors[method], _known(values)) for method, values in frames["correct"].items()]
    chart = box_chart("frames to a correct map", boxes, time)
    note = "Trials with a correct map: median, quartiles, 5th and 95th percentile."
    return [*charts, _figure("Frames to a correct map", note, chart), _reasons(figures)]


def _described(title: str, curves: Mapping[str, tuple[Floats, Floats]], colors: Mapping[str, str]) -> str:
    """Return the label of a chart for screen readers: where each curve ends."""
    ends = [(method_label(method), curves[color][1]) for method, color in colors.items() if color in curves]
    return f"{title}; at the end " + ", ".join(f"{name} {100 * ys[-1] if len(ys) else 0:.0f} %" for name, ys in ends)


def _reasons(figures: Mapping[str, Figures]) -> str:
    """Draw the shares of the reasons for which there is no map, with one bar per method."""
    names = list(dict.fromkeys(reason for f in figures.values() for reason, n in f.reasons.items() if n))
    names.sort(key=lambda name: -sum(f.reasons.get(name, 0) for f in figures.values()))
    shown = names[: _COLORS - 1]
    rows = []
    for method, f in figures.items():
        pieces = [(f"r{i}", 100 * f.reasons.get(name, 0) / max(f.trials, 1)) for i, name in enumerate(shown)]
        rest = sum(f.reasons.get(name, 0) for name in names[_COLORS - 1 :])
        rows.append((method_label(method), [*pieces, ("r9", 100 * rest / max(f.trials, 1))]))
    most = max((sum(length for _, length in pieces) for _, pieces in rows), default=0.0)
    legend = [(f"r{i}", in_words(name)) for i, name in enumerate(shown)]
    if names[_COLORS - 1 :]:
        legend.append(("r9", "other"))
    chart = stacked_chart("reasons", rows, Axis("% of the trials", 0, 100 * _above(most / 100)))
    return _figure(
        "Why there is no map", "Share of the trials that ended without a map, by reason.", chart + _legend(legend)
    )


# -- the stated risk -------------------------------------------------------------------------------


def _reliability_section(reliability: Mapping[str, Mapping[str, Reliability]], colors: Mapping[str, str]) -> str:
    levels = []
    for level, by_method in reliability.items():
        series = {
            colors[method]: [(100 * one.mean_risk, _percent(one.false_rate)) for one in of_method.bins if one.maps]
            for method, of_method in by_method.items()
        }
        labels = ("mean stated risk (%)", "false maps (%)")
        stated, observed = (Axis(label, *_RISK_PERCENT, log=True) for label in labels)
        chart = _figure(
            f"Reliability diagram: {LEVELS[level]}",
            "One point for each bin of the stated risk, with the interval of its share of false maps. A share of 0 is "
            "drawn at the lower end. Dashed line: the share is equal to the stated risk. If the risk is reliable, "
            "about 19 of 20 intervals cross this line.",
            interval_chart(f"reliability diagram, {LEVELS[level]}", series, stated, observed),
        )
        levels.append(
            page_part(
                "level",
                title=_capital(LEVELS[level]),
                risks=risk_table(by_method),
                coverage=coverage_table(by_method),
                legend=_legend([(colors[method], method_label(method)) for method in by_method]),
                chart=chart,
            )
        )
    return page_part("reliability", levels="".join(levels))


# -- parts -----------------------------------------------------------------------------------------


def _figure(title: str, note: str, content: str) -> str:
    return f"<figure><figcaption><b>{escape(title)}</b>{escape(note)}</figcaption>{content}</figure>"


def _legend(entries: Sequence[tuple[str, str]]) -> str:
    items = "".join(f'<li><i class="{name}"></i>{escape(label)}</li>' for name, label in entries)
    return f'<ul class="legend">{items}</ul>'


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _percent(share: Interval) -> Interval:
    return Interval(100 * share.value, 100 * share.low, 100 * share.high)


def _known(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _cumulative(values: Floats, total: int) -> tuple[Floats, Floats]:
    """Return the values at which a curve of shares rises, and the share at each of them."""
    xs, counts = np.unique(values, return_counts=True)
    return xs, np.cumsum(counts) / max(total, 1)


def _above(share: float) -> float:
    """Return a round upper end of an axis, at least 5 %."""
    return min(1.0, max(0.05, math.ceil(share * 22) / 20))


def method_colors(methods: Sequence[str]) -> dict[str, str]:
    """Give each method a CSS class.

    A method of the registry has the class of its place there, which does not depend on the other methods of a report.
    Two names of one method share a class, unless both are in the report. Other methods get the remaining classes in
    their order; if there are more methods than classes, classes repeat.
    """
    own = [name for name, info in METHODS.items() if info.alias_of is None]
    places = {name: position % _METHOD_COLORS for position, name in enumerate(own)}
    for name, info in METHODS.items():
        if info.alias_of is not None and info.alias_of not in methods:
            places[name] = places[info.alias_of]
    chosen = {method: places[method] for method in methods if method in places}
    free = [k for k in range(_METHOD_COLORS - 1, -1, -1) if k not in chosen.values()] or list(range(_METHOD_COLORS))
    others = (method for method in methods if method not in chosen)
    chosen |= {method: free[k % len(free)] for k, method in enumerate(others)}
    return {method: f"c{chosen[method]}" for method in methods}
