"""``slam-init bench publish DIR...``: one static page from the score sheets of several runs.

Rows are compared only if their runs had the same protocol: the same suite, worlds, seed, starts and sequences, and the
same digests of the tracks. Each such group has a table of its own. Nothing in a sheet is trusted: it is read within a
bound, each value is checked, and every text is escaped.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from slam_init.bench.protocol import DEFAULTS, NAME, VERSION
from slam_init.bench.sheet import SCHEMA
from slam_init.compare.rows import finite_json
from slam_init.compare.statistics import Interval
from slam_init.compare.tables import html_figure, page_html, page_part, share_bar
from slam_init.errors import SourceError
from slam_init.output.folder import OutputFolder, output_error
from slam_init.output.names import PAGE, SHEET_FILES
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
    label: str
    command: str
    about: str
    trials: int
    #: correct, false, none, delay: As in the sheet.
    correct: Interval
    false: Interval
    none: Interval
    delay: Interval
    #: Number of trials with a correct map, a false one, none, and an error.
    outcomes: tuple[int, int, int, int]
    #: Of maps with a stated risk: false ones, and the expected number.
    risk: str
    frame_ms: float | None
    machine: str
    #: Where the sheet lies.
    folder: str

    @property
    def score(self) -> float:
        """The rank: share of correct maps minus :data:`FALSE_COST` times that of false maps."""
        correct, false = (0.0 if math.isnan(share.value) else share.value for share in (self.correct, self.false))
        return correct - FALSE_COST * false


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
    try:
        sheet = finite_json(read_regular(path, _MAX_BYTES, "a score sheet", SourceError))
        if sheet.get("benchmark") != NAME or sheet.get("version") != VERSION or sheet.get("schema") != SCHEMA:
            raise SourceError(f"{path} is no score sheet of {NAME} {VERSION}: run slam-init bench again")
        return _entries(sheet, folder)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise SourceError(f"{path} is damaged: run slam-init bench again") from None


def _entries(sheet: Mapping[str, Any], folder: str) -> list[Entry]:
    run, frozen = sheet["run"], sheet["frozen"]
    suite = _text(sheet["suite"])
    if suite not in DEFAULTS:
        raise ValueError("an unknown suite")
    sequences = [_text(name) for name in sheet["sequences"]]
    state = "other tracks than the frozen ones" if frozen["different"] else "frozen tracks"
    parts = [f"{len(sequences)} {'sequences' if suite == 'video' else 'worlds'}", f"seed {int(run['seed'])}"]
    parts += [] if suite == "drawn" else [f"every {int(run['every'])} frames"]
    parts += [state if not frozen["unknown"] or frozen["different"] else "not frozen"]
    if suite == "video":
        parts.append(", ".join(sequences))
    if frozen["different"]:  # such runs can be compared with themselves only
        parts.append(f"on {_text(sheet['machine'].get('processor', ''))}, {folder}")
    machine = ", ".join(_text(value) for value in sheet["machine"].values())
    entries = []
    for row in sheet["rows"]:
        risk = row["risk"]
        frame_ms = sheet["times"][row["method"]]["frame_ms"]
        entries.append(
            Entry(
                group=f"{suite}: {'; '.join(parts)}",
                suite=suite,
                label=_text(row["label"]),
                command=_text(row["command"]),
                about=_text(row["about"]),
                trials=int(row["trials"]),
                correct=_interval(row["correct"]),
                false=_interval(row["false"]),
                none=_interval(row["none"]),
                delay=_interval(row["delay"]),
                outcomes=_outcomes(row),
                risk="" if risk is None else f"{int(risk['false'])} ({_known(risk['expected_false']) or 0.0:.2g})",
                frame_ms=_known(frame_ms),
                machine=machine[:_MAX_TEXT],
                folder=folder,
            )
        )
    return entries


def _outcomes(row: Mapping[str, Any]) -> tuple[int, int, int, int]:
    """Numbers of trials by their outcome; a false map in a trial that no map can solve counts as well."""
    trials, solvable, false, errors = (int(row[name]) for name in ("trials", "solvable", "false_maps", "errors"))
    correct = round(solvable * (_known(row["correct"][0]) or 0.0))
    return correct, false, max(0, trials - correct - false - errors), errors


def leaderboard_html(entries: Sequence[Entry]) -> str:
    """Make the page."""
    groups: dict[str, list[Entry]] = {}
    for entry in entries:
        groups.setdefault(entry.group, []).append(entry)
    order = list(DEFAULTS)
    body = [page_part("leaderboard", name=f"{NAME} {VERSION}", cost=FALSE_COST)]
    for name, rows in sorted(groups.items(), key=lambda item: (order.index(item[1][0].suite), item[0])):
        body.append(_section(name, sorted(rows, key=lambda entry: (-entry.score, entry.label))))
    return page_html(f"{NAME} {VERSION}", body)


def _section(name: str, entries: Sequence[Entry]) -> str:
    columns = [("method", ""), ("score", "more"), ("correct %", ""), ("false %", ""), ("delay<br>(frames)", "")]
    columns += [
        (title, "more") for title in ("none %", "error", "trials", "risk: false<br>(expected)", "frame<br>(ms)")
    ]
    head = "".join(f'<th scope="col"{_class(kind)}>{title}</th>' for title, kind in columns)
    rows = "".join(
        f'<tr><th scope="row" title="{escape(entry.about)}">{escape(entry.label)}</th>'
        + "".join(f"<td{_class(kind)}>{cell}</td>" for cell, (_, kind) in zip(_cells(entry), columns[1:], strict=True))
        + "</tr>"
        for entry in entries
    )
    chart = "".join(
        f"<b>{escape(entry.label)}</b>{share_bar(list(zip(OUTCOMES, entry.outcomes, strict=True)))}"
        f"<span>{100 * entry.score:.0f}</span>"
        for entry in entries
    )
    legend = "".join(f'<li><i class="{outcome}"></i>{outcome}</li>' for outcome in OUTCOMES)
    commands = "".join(
        f"<li><b>{escape(entry.label)}</b> <code>{escape(entry.command)}</code>"
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
    return [
        f"{100 * entry.score:.1f}",
        html_figure(entry.correct, 1, 100),
        html_figure(entry.false, 1, 100),
        html_figure(entry.delay, 2),
        html_figure(entry.none, 1, 100),
        str(entry.outcomes[3]),
        str(entry.trials),
        escape(entry.risk) or "-",
        html_figure(entry.frame_ms),
    ]


def _interval(value: object) -> Interval:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError("no interval")
    known = [_known(end) for end in value]
    return Interval(*(math.nan if end is None else end for end in known))


def _known(value: object) -> float | None:
    """A number, or None; a text such as "nan" is neither."""
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise TypeError("not a number")
    return None if value is None else float(value)


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError("not a text")
    return value[:_MAX_TEXT]
