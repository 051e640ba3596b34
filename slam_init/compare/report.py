"""The tables of a comparison, for the terminal and for ``report.html``: a page that loads nothing from other places."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_init.compare.figures import DIRECTION_SIGMAS, LEVELS, PARTS, ROTATION_SIGMAS, Figures
from slam_init.compare.statistics import Interval
from slam_init.methods.external_command import method_label
from slam_init.types.arrays import Floats
from slam_init.types.refusal import in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame, Series

#: The columns of the terminal: heading, figure, digits behind the point, factor. The page has its own in its template.
_MOVING = (
    ("trials", "trials", 0, 1), ("correct (%)", "correct_rate", 1, 100), ("strict (%)", "strict_share", 1, 100),
    ("false (%)", "false_rate", 1, 100), ("audited risk (%)", "audited_risk", 1, 100), ("none", "none", 0, 1),
    ("plane: right map kept (%)", "kept_truth_rate", 1, 100), ("error", "error", 0, 1), ("wait (frames)", "wait", 2, 1),
    ("rotation (deg)", "rotation_error_deg", 2, 1), ("direction (deg)", "direction_error_deg", 2, 1),
    ("survival (%)", "survival", 0, 100), ("frame (ms)", "frame_median_ms", 1, 1),
)  # fmt: skip
#: Those without translation: a static or rotation-only camera.
_STATIC = (
    ("trials", "trials", 0, 1), ("false (%)", "false_rate", 1, 100), ("audited risk (%)", "audited_risk", 1, 100),
    ("none", "none", 0, 1), ("error", "error", 0, 1), ("expected reason (%)", "reason_accuracy", 1, 100),
    ("focal error suspected (%)", "suspicion_rate", 1, 100), ("focal error reported (%)", "report_rate", 1, 100),
)  # fmt: skip
_WAITS = (("trials", "trials", 0, 1), ("sequences", "sequences", 0, 1), ("wait (frames)", "difference_frames", 2, 1))
_RELIABILITY = (
    ("maps", "maps", 0, 1), ("mean model risk (%)", "mean_risk", 3, 100), ("expected false", "expected_false", 3, 1),
    ("false", "false", 0, 1), ("false (%)", "false_rate", 1, 100), ("direction covered (%)", "direction", 1, 100),
    ("rotation covered (%)", "rotation", 1, 100),
)  # fmt: skip
#: A terminal shows at least this number of columns.
_TERMINAL_WIDTH = 120
#: Colour of letters and lines that can be read on a light and on a dark page.
_GREY = "#808890"


def figure_text(value: Interval | float | None, digits: int = 1, factor: float = 1.0, ends: str = " [{}, {}]") -> str:
    """Write a figure; an interval with its ends where they are known, ``-`` for a figure that is not known."""
    first, others = known_value(value), value[1:] if isinstance(value, Interval) else ()
    if first is None:
        return "-"
    known = [f"{factor * end:.{digits}f}" for end in others if not math.isnan(end)]
    return f"{factor * first:.{digits}f}{ends.format(*known) if known else ''}"


def known_value(value: Interval | float | None) -> float | None:
    """Return the value of a figure without its interval; None where it is not known."""
    first = value.value if isinstance(value, Interval) else value
    return None if first is None or math.isnan(first) else first


def shown(figures: Figures) -> Figures:
    """Return the figures that tables show by one name each."""
    strict = None if known_value(figures["correct_rate"]) is None else figures["strict"] / figures["trials"]
    return {**figures, **figures["medians"], "strict_share": strict}


def main_table(summary: Figures) -> str:
    """Return the main table of each part of a comparison.

    * Returns: For each part the methods, and for a moving camera the paired differences of the wait. Then the
      reliability of the stated risk, if a method states one.
    """
    tables = []
    for part, by_method in summary["parts"].items():
        columns = _STATIC if part.endswith("static") else _MOVING
        figures = {method_label(method): shown(one) for method, one in by_method.items()}
        tables.append(_table(PARTS[part], figures, columns))
        if waits := [one for one in summary["waits"].get(part, ()) if one["trials"]]:
            title = f"wait of {method_label(waits[0]['first'])} minus that of"
            tables.append(_table(title, {method_label(one["second"]): one for one in waits}, _WAITS))
    for level, by_method in summary["reliability"].items():
        rows: dict[str, dict[str, Any]] = {}
        for method, reliability in by_method.items():
            label = f"{method_label(method)}, risk"
            rows |= {f"{label} {name}": dict(one) for name, one in named_bins(reliability)}
            rows[f"{label} all"] |= {name: reliability[name]["rate"] for name in ("direction", "rotation")}
        tables.append(_table(f"risk by the model, {LEVELS[level]}", rows, _RELIABILITY))
    return "\n\n".join(tables)


def _table(title: str, rows: Mapping[str, Figures], columns: Sequence[tuple[str, str, int, int]]) -> str:
    """Write a table for a terminal. A column without a value is left out, and a wide table is broken."""
    from pandas import DataFrame

    cells = {
        heading: [figure_text(row.get(name), digits, factor) for row in rows.values()]
        for heading, name, digits, factor in columns
    }
    known = {heading: column for heading, column in cells.items() if set(column) != {"-"}}
    table: str = DataFrame(known, index=list(rows)).rename_axis(columns=title).to_string(line_width=_TERMINAL_WIDTH)
    return "\n".join(line.rstrip(" \\") for line in table.splitlines())


def named_bins(reliability: Figures) -> list[tuple[str, Figures]]:
    """Return the bins with maps and all maps, each with its name in a table."""
    bins = [(f"{100 * one['low']:g} to {100 * one['high']:g} %", one) for one in reliability["bins"] if one["maps"]]
    return [*bins, ("all", reliability["total"])]


# -- the page --------------------------------------------------------------------------------------


def report_html(table: DataFrame, summary: Figures, command: str, notes: Sequence[str]) -> str:
    """Make the page of ``report.html``, which is a template of jinja2."""
    from jinja2 import Environment

    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(figure=figure_text, value=known_value, shown=shown, label=method_label, bins=named_bins)
    text = files("slam_init.compare").joinpath("report.html").read_text(encoding="utf-8")
    return environment.from_string(text).render(
        summary=summary,
        command=command,
        notes=notes,
        parts=PARTS,
        levels=LEVELS,
        sigmas={"direction": DIRECTION_SIGMAS, "rotation": ROTATION_SIGMAS},
        false_maps=table[table["outcome"] == "false"].to_dict("records"),
        charts={part: _charts(table[table["part"] == part], summary["methods"]) for part in summary["parts"]},
    )


def _charts(table: DataFrame, methods: Sequence[str]) -> dict[str, str]:
    """The charts of a part, by their headings."""
    outcome, frames, limit = table["outcome"], table["frames_to_accept"], max(int(table["frames_limit"].max()), 2)
    charts = {}
    if table["part"].str.endswith("moving").any():
        time, errors = np.arange(0.5, limit + 1), np.geomspace(0.01, 180, 400)
        for title, values, edges, axis in (
            ("Correct maps over time", frames.where(outcome == "correct"), time, {"xlabel": "frames since the start"}),
            ("False maps over time", frames.where(outcome == "false"), time, {"xlabel": "frames since the start"}),
            ("Rotation error", table["rotation_error_deg"], errors, {"xlabel": "degrees (1, 5)", "xscale": "log"}),
            ("Direction error", table["direction_error_deg"], errors, {"xlabel": "degrees (5, 15)", "xscale": "log"}),
        ):
            by_method = [values[table["method"] == method] for method in methods]
            charts[title] = _svg(_curves(by_method, edges, methods), ylabel="share of trials", ylim=(0, None), **axis)
    ended = table[outcome.isin(["none", "error"])]
    shares = 100 * ended.groupby(["method", "reason"]).size() / table.groupby("method").size()
    bars = shares.unstack().reindex(list(methods)[::-1]).rename(index=method_label, columns=in_words)
    if bars.size:
        charts["Why there is no map"] = _svg(lambda plot: bars.plot.barh(stacked=True, ax=plot), xlabel="% of trials")
    return charts


def _curves(by_method: Sequence[Series[float]], edges: Floats, methods: Sequence[str]) -> Callable[[Axes], object]:
    """Draw the share of the trials of each method with at most a value; a trial without one has none."""
    known = [values.dropna().clip(edges[0], edges[-1]) for values in by_method]
    weights = [np.full(len(some), 1 / max(len(all_), 1)) for some, all_ in zip(known, by_method, strict=True)]
    labels = [method_label(method) for method in methods]
    return lambda plot: plot.hist(
        known, edges.tolist(), weights=weights, cumulative=True, histtype="step", label=labels
    )


def _svg(draw: Callable[[Axes], object], **axes: Any) -> str:
    """Draw a chart."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    grey: Any = dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), _GREY)
    # Without a margin the drop to 0 behind the last value of a curve lies on the frame.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": str(axes), "font.size": 8, "axes.xmargin": 0, **grey}):
        figure = Figure(figsize=(5.2, 3.2), layout="constrained")
        plot = figure.subplots()
        draw(plot)
        plot.set(**axes)
        plot.grid(alpha=0.3)
        plot.legend(fontsize="small", framealpha=0.5)
        text = StringIO()
        metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(text, format="svg", transparent=True, metadata=metadata)
    return text.getvalue()[text.getvalue().index("<svg") :]
