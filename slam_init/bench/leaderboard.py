"""``slam-init bench publish DIR...``: one static page from the score sheets of several runs.

Rows are compared only if their runs had the same protocol: the same suite, worlds, seed, starts and sequences, and the
same digests of the tracks. Each such group has a table of its own. Nothing in a sheet is trusted: it is read within a
bound, each value is checked, and every text is escaped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from slam_init.bench.protocol import DEFAULTS, NAME, VERSION
from slam_init.bench.sheet import SCHEMA, Row, Sheet
from slam_init.compare.tables import html_figure, page_html, page_part, share_bar
from slam_init.errors import SourceError
from slam_init.output.folder import OutputFolder, output_error
from slam_init.output.names import PAGE, SHEET_FILES
from slam_init.output.plain_json import parsed
from slam_init.system.regular_file import check_inside, read_regular, user_path

#: A sheet of 1,000 worlds and 20 methods has 300 kB.
_MAX_BYTES = 20_000_000
#: More sheets than anybody compares on one page.
_MAX_SHEETS = 1000
_MAX_TEXT = 2000
#: A start without a map costs frames; a false one costs what is built on it. With this cost a method whose maps are
#: false in a tenth of the trials ranks no higher than one that never answers.
FALSE_COST = 10
OUTCOMES = ("correct", "false", "none", "error")


@dataclass(frozen=True)
class Entry:
    """A row of a leaderboard."""

    #: Rows of one group can be compared.
    group: str
    suite: str
    row: Row
    frame_ms: float | None
    machine: str
    #: Where the sheet lies.
    folder: str

    @property
    def score(self) -> float:
        """The rank: share of correct maps minus :data:`FALSE_COST` times that of false maps."""
        shares = (self.row.correct, self.row.false)
        correct, false = (0.0 if math.isnan(share.value) else share.value for share in shares)
        return correct - FALSE_COST * false

    @property
    def outcomes(self) -> tuple[int, int, int, int]:
        """Numbers of trials by their outcome; a false map in a trial that no map can solve counts as well."""
        row = self.row
        correct = 0 if math.isnan(row.correct.value) else round(row.solvable * row.correct.value)
        return correct, row.false_maps, max(0, row.trials - correct - row.false_maps - row.errors), row.errors


@dataclass(frozen=True)
class _Head:
    """What tells whether a file is a score sheet of this version."""

    schema: int
    benchmark: str
    version: int
    suite: str


def publish(folders: Sequence[str], out: Path) -> str:
    """Write the page."""
    if len(folders) > _MAX_SHEETS:
        raise SourceError(f"{len(folders)} folders: give at most {_MAX_SHEETS}")
    entries = [entry for folder in folders for entry in read_entries(folder)]
    page = leaderboard_html(entries)
    with OutputFolder(out, "bench publish", (PAGE,)) as folder:
        try:
            (folder.staging / PAGE).write_bytes(page.encode("utf-8", "backslashreplace"))
        except OSError as error:
            raise output_error(out, error) from error
        folder.publish([PAGE])
    return f"{len(entries)} rows of {len(folders)} runs: {out / PAGE}\n"


def read_entries(folder: str) -> list[Entry]:
    """Read the score sheet of a run."""
    path = user_path(folder) / SHEET_FILES[0]
    if not path.exists():
        raise SourceError(f"{folder} has no {SHEET_FILES[0]}: give folders of results of slam-init bench")
    check_inside(path, user_path(folder))
    text = read_regular(path, _MAX_BYTES, "a score sheet", SourceError)
    try:
        head = parsed(_Head, text)
        if (head.benchmark, head.version, head.schema) != (NAME, VERSION, SCHEMA):
            raise SourceError(f"{path} is no score sheet of {NAME} {VERSION}: run slam-init bench again")
        sheet = parsed(Sheet, text)
        if (
            head.suite not in DEFAULTS
            or head.suite != sheet.run.suite
            or not all(row.method in sheet.times for row in sheet.rows)
        ):
            raise ValueError("an unknown suite, or a row without times")
    except ValueError:
        raise SourceError(f"{path} is damaged: run slam-init bench again") from None
    group, machine = _group(sheet, folder), ", ".join(sheet.machine.values())
    return [Entry(group, sheet.run.suite, row, sheet.times[row.method].frame_ms, machine, folder) for row in sheet.rows]


def _group(sheet: Sheet, folder: str) -> str:
    """Tell with which rows those of a sheet can be compared."""
    suite, frozen = sheet.run.suite, sheet.frozen
    state = "other tracks than the frozen ones" if frozen.different else "frozen tracks"
    parts = [f"{len(sheet.sequences)} {'sequences' if suite == 'video' else 'worlds'}", f"seed {sheet.run.seed}"]
    parts += [] if suite == "drawn" else [f"every {sheet.run.every} frames"]
    parts += [state if not frozen.unknown or frozen.different else "not frozen"]
    if suite == "video":
        parts.append(", ".join(sheet.sequences))
    if frozen.different:  # such runs can be compared with themselves only
        parts.append(f"on {sheet.machine.get('processor', '')}, {folder}")
    return f"{suite}: {'; '.join(parts)}"


def leaderboard_html(entries: Sequence[Entry]) -> str:
    """Make the page."""
    groups: dict[str, list[Entry]] = {}
    for entry in entries:
        groups.setdefault(entry.group, []).append(entry)
    order = list(DEFAULTS)
    body = [page_part("leaderboard", name=f"{NAME} {VERSION}", cost=FALSE_COST)]
    for name, rows in sorted(groups.items(), key=lambda item: (order.index(item[1][0].suite), item[0])):
        body.append(_section(name, sorted(rows, key=lambda entry: (-entry.score, entry.row.label))))
    return page_html(f"{NAME} {VERSION}", body)


def _section(name: str, entries: Sequence[Entry]) -> str:
    columns = [("method", ""), ("score", "more"), ("correct %", ""), ("false %", ""), ("delay<br>(frames)", "")]
    columns += [
        (title, "more") for title in ("none %", "error", "trials", "risk: false<br>(expected)", "frame<br>(ms)")
    ]
    head = "".join(f'<th scope="col"{_class(kind)}>{title}</th>' for title, kind in columns)
    rows = "".join(
        f'<tr><th scope="row" title="{escape(entry.row.about)}">{escape(entry.row.label)}</th>'
        + "".join(f"<td{_class(kind)}>{cell}</td>" for cell, (_, kind) in zip(_cells(entry), columns[1:], strict=True))
        + "</tr>"
        for entry in entries
    )
    chart = "".join(
        f"<b>{escape(entry.row.label)}</b>{share_bar(list(zip(OUTCOMES, entry.outcomes, strict=True)))}"
        f"<span>{100 * entry.score:.0f}</span>"
        for entry in entries
    )
    legend = "".join(f'<li><i class="{outcome}"></i>{outcome}</li>' for outcome in OUTCOMES)
    commands = "".join(
        f"<li><b>{escape(entry.row.label)}</b> <code>{escape(entry.row.command)}</code>"
        f'<br><span class="soft">{escape(entry.machine)}; {escape(entry.folder)}</span></li>'
        for entry in entries
    )
    return (
        f"<h2>{escape(name)}</h2>"
        f'<figure><figcaption><b>Outcomes of the trials, and the score</b></figcaption><div class="board">{chart}</div>'
        f'<ul class="legend">{legend}</ul></figure>'
        f'<div class="scroll board-table"><table class="sortable"><caption>{escape(name)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
        f"<details><summary>Commands that give these rows, and machines</summary><ul>{commands}</ul></details>"
    )


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def _cells(entry: Entry) -> list[str]:
    """The cells of a row behind the name of the method."""
    row = entry.row
    return [
        f"{100 * entry.score:.1f}",
        html_figure(row.correct, 1, 100),
        html_figure(row.false, 1, 100),
        html_figure(row.delay, 2),
        html_figure(row.none, 1, 100),
        str(row.errors),
        str(row.trials),
        "-" if row.risk is None else f"{row.risk.false} ({row.risk.expected_false:.2g})",
        html_figure(entry.frame_ms),
    ]
