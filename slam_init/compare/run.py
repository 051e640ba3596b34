"""Runs a whole comparison: tracks, trials, result files."""

from __future__ import annotations

import csv
import io
import os
import shutil
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path

from slam_init.compare.figures import Figures, summary_of, table_of
from slam_init.compare.report import report_html
from slam_init.compare.rows import COLUMNS, Journal, TrialRow
from slam_init.compare.suites import Suite
from slam_init.compare.trials import Plan
from slam_init.compare.workers import DASK, run_on_cluster, run_trials, track_sources
from slam_init.config import Config
from slam_init.datasets.synth import POINTS
from slam_init.datasets.views import SourceView
from slam_init.errors import ConfigError
from slam_init.initializer import load_all
from slam_init.methods.external_command import is_external, method_label
from slam_init.output.folder import OutputFolder
from slam_init.output.names import TRIALS
from slam_init.output.plain_json import Json, json_text

#: The packages of the extra ``compare``.
_PACKAGES = ("pandas", "jinja2", "pebble")
_RESULTS, _REPORT, _SUMMARY = "results.csv", "report.html", "summary.json"
#: The folder of the tracks, while trials run.
_TRACKS = "tracks"


def compare(
    plan: Plan,
    out: str | os.PathLike[str],
    *,
    backend: str | None = None,
    jobs: int = 1,
    progress: bool = False,
    command: str = "",
    frozen: Suite | None = None,
) -> tuple[Figures, list[str]]:
    """Run all trials that ``out`` does not hold yet, and write the results.

    A script calls it below ``if __name__ == "__main__"``, because the processes of the trials import the script.

    * ``out``: Folder of ``trials.jsonl``, ``results.csv``, ``summary.json`` and ``report.html``: a new or an empty one,
      or one of an earlier comparison. Earlier results stay until all trials have ended.
    * ``backend``: ``dask:ADDRESS`` of the scheduler of a cluster; by default processes of this machine.
    * ``jobs``: Number of these processes.
    * ``command``: A command that gives the same results, for the report.
    * ``frozen``: The suite whose worlds the sources are.
    * Returns: The figures of ``summary.json``, and notes.
    """
    from tqdm import tqdm

    for package in _PACKAGES:
        if find_spec(package) is None:
            raise ConfigError(f'slam-init compare needs the package {package}: pip install "slam-init[compare]"')
    if backend and not backend.startswith(DASK):
        raise ConfigError(f"unknown backend {backend!r}: use dask:ADDRESS, or --jobs N for processes of this machine")
    with OutputFolder(out, "compare", own=TRIALS) as folder:
        settings = replace(plan.settings, tracks=str((folder.staging / _TRACKS).resolve()))
        criteria = {source.label: source.criteria.rule for source in plan.sources}
        edited = _edited_since(folder.path / TRIALS, plan.methods)
        # A trial is run again if other criteria evaluated it, or if the file of its method is newer.
        with Journal(
            folder.path / TRIALS,
            _shared_settings(plan),
            lambda row: row.evaluated_by == criteria.get(row.source, row.evaluated_by) and row.method not in edited,
        ) as journal:
            missing = [trial for trial in plan.trials() if trial.key not in journal.rows]
            unfinished = {trial.source.label for trial in missing if not backend}
            images = [source for source in plan.sources if not source.text.startswith(POINTS)]
            with tqdm(total=len(missing), unit="trial", desc="tracks", disable=not progress, leave=False) as bar:
                # The checksum of a suite is that of all its tracks.
                tracked = plan.sources if frozen else [source for source in images if source.label in unfinished]
                digests = dict(track_sources(tracked, settings, jobs))
                if unfinished:
                    load_all()  # no trial waits for the compiler
                bar.set_description("trials")
                ended = run_on_cluster(backend, missing, settings) if backend else run_trials(missing, settings, jobs)
                with closing(ended):  # an error or an interrupt ends the processes at once
                    for row in ended:
                        journal.append(row)
                        bar.update()
            rows = [journal.rows[key] for key in sorted(trial.key for trial in plan.trials())]
        shutil.rmtree(folder.staging / _TRACKS, ignore_errors=True)  # no result
        notes = [frozen.verdict(digests[source.label] for source in plan.sources)] if frozen else []
        if points := sum(source.group.startswith(POINTS) for source in plan.sources):
            left_out = f"on {points} points: sources, because an external program needs images"
            notes += [f"not applicable: {method_label(one)} {left_out}" for one in plan.methods if is_external(one)]
        first = {row.method: row.reason for row in reversed(rows) if row.outcome == "error"}
        for one, count in Counter(row.method for row in rows if row.outcome == "error").items():
            notes.append(f"{method_label(one)}: trials that ended in an error: {count}, the first: {first[one]}")
        return _publish(folder, rows, plan, command, notes), notes


def _edited_since(journal: Path, methods: Sequence[str]) -> set[str]:
    """The methods whose Python file was written after the last trial of a journal."""
    files = {one: Path(one.rpartition(":")[0]) for one in methods if not is_external(one)}
    last = journal.stat().st_mtime if journal.exists() else 0.0
    return {
        one for one, file in files.items() if file.suffix == ".py" and file.is_file() and file.stat().st_mtime > last
    }


def _shared_settings(plan: Plan) -> dict[str, Json]:
    """Return the settings that must be equal for all rows of a results folder."""
    given: dict[str, Json] = {
        "view": ", ".join(sorted({SourceView.parse(source.text)[0].query for source in plan.sources} - {""})),
        "audit": plan.settings.audit,  # rows that were not audited lack a figure
    }
    # Those of another version may differ. The limits of external programs do not change the result of a trial, unless
    # it is an error.
    options = asdict(Config(method="", seed=0))
    return {
        **{name: value for name, value in given.items() if value},
        **{name: getattr(plan.settings, name) for name in ("seed", "limit_frames", "limit_s")},
        "options": {name: value for name, value in options.items() if name != "external"},
    }


def _publish(folder: OutputFolder, rows: Sequence[TrialRow], plan: Plan, command: str, notes: Sequence[str]) -> Figures:
    """Write all result files: either all are replaced, or none."""
    table = table_of(rows)
    summary = summary_of(table, plan)
    texts = {_REPORT: report_html(table, summary, command, notes), _SUMMARY: json_text(summary)}
    with io.StringIO(newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in rows:
            values = asdict(row).values()
            writer.writerow([str(value).lower() if isinstance(value, bool) else value for value in values])
        texts[_RESULTS] = file.getvalue()
    # File names need not be valid Unicode.
    folder.write({name: text.encode("utf-8", "backslashreplace") for name, text in texts.items()})
    folder.publish(last=_SUMMARY)
    return summary


def chosen_methods(text: str | None, further: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the methods of the options ``--methods`` and ``--method``.

    * ``text``: Names, separated by commas; None for all methods whose packages are installed, each under one name.
    * ``further``: Further methods. The command of an external program may hold commas.
    """
    from slam_init.methods import METHODS, make_two_view, method_info

    if text is None:
        installed = (info for info in METHODS.values() if info.needs is None or find_spec(info.needs))
        text = ",".join(info.name for info in installed if info.alias_of is None and info.name not in further)
    names = (*(text.split(",") if text else ()), *further)
    for name in names:
        method_info(name).check_installed()
        if ":" in name and not is_external(name):
            make_two_view(name)
    labels = [method_label(name) for name in names]
    for label in labels:
        if labels.count(label) > 1:
            raise ConfigError(f"two methods are named {label}: give each once, or name one, as in NAME=command:PROGRAM")
    return names
