"""Runs a whole comparison: tracks, trials, result files."""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from slam_init.compare.backends import Backend, open_backend
from slam_init.compare.isolation import isolated_tracks, isolated_trial
from slam_init.compare.journal import Journal
from slam_init.compare.plan import Plan
from slam_init.compare.results import remove_results, write_results
from slam_init.compare.rows import TrialRow
from slam_init.compare.summary import ComparisonSummary
from slam_init.compare.trials import Settings
from slam_init.datasets.points import POINTS
from slam_init.errors import OutputError
from slam_init.output.plain_json import Json

__all__ = ["compare"]

_JOURNAL = "trials.jsonl"
_RECORDINGS = "recordings"


def compare(
    plan: Plan,
    out: str | os.PathLike[str],
    *,
    backend: str = "loky",
    jobs: int = 1,
    recordings: bool = False,
    progress: bool = False,
    command: str = "",
) -> ComparisonSummary:
    """Run all trials that ``out`` does not hold yet, and write the results.

    Parameters
    ----------
    plan : Plan
    out : str or os.PathLike
        Folder of ``trials.jsonl``, ``results.csv``, ``summary.json``, ``report.html`` and the recordings. It is created
        if it does not exist.
    backend : str
        ``loky``, ``sequential`` or ``dask:ADDRESS``; see :func:`slam_init.compare.backends.open_backend`.
    jobs : int
        Number of processes of the backend loky.
    recordings : bool
        Write recordings of the trials that are run now.
    progress : bool
        Show a progress bar on stderr.
    command : str
        The command line that the report shows; empty for none.

    Returns
    -------
    ComparisonSummary
        The content of ``summary.json``.

    Raises
    ------
    SlamInitError
        If a source cannot be read, the backend is not available, or ``out`` cannot be written.
    """
    out = Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        tracks = tempfile.mkdtemp(prefix="slam-init-tracks-")
    except OSError as error:
        raise OutputError(f"cannot write to --out {out}: {error.strerror or error}: give another folder") from error
    folder = str((out / _RECORDINGS).resolve()) if recordings else None
    settings = replace(plan.settings, tracks=tracks, recordings=folder)
    try:
        with Journal(out / _JOURNAL, _shared_settings(settings), partial(_is_current, plan)) as journal:
            remove_results(out)
            with open_backend(backend, jobs) as workers:
                _run_trials(plan, settings, journal, workers, progress)
                if recordings:
                    _side_by_side(plan, settings, journal)
            return write_results(out, journal.rows(plan.holds), plan, command)
    finally:
        shutil.rmtree(tracks, ignore_errors=True)


def _shared_settings(settings: Settings) -> dict[str, Json]:
    """Return the settings that must be equal for all rows of a results folder."""
    return {
        "seed": settings.seed,
        "limit_frames": settings.limit_frames,
        "limit_s": settings.limit_s,
        "options": asdict(replace(settings.config, method="", seed=0)),
    }


def _is_current(plan: Plan, row: TrialRow) -> bool:
    """Return whether a stored row was judged by the criteria of this version; the trial is run again otherwise."""
    criteria = plan.criteria.get(row.source)
    return criteria is None or criteria.judged(row.judged_by)


def _run_trials(plan: Plan, settings: Settings, journal: Journal, workers: Backend, progress: bool) -> None:
    from tqdm import tqdm

    missing = sum(trial.key not in journal for trial in plan.trials())
    with tqdm(total=missing, unit="trial", desc="tracks", disable=not progress, leave=False) as bar:
        unfinished = {trial.source.text for trial in plan.trials() if trial.key not in journal}
        tracked = sorted(text for text in unfinished if not text.startswith(POINTS))
        for _ in workers.run(partial(isolated_tracks, settings=settings), tracked):
            bar.refresh()
        bar.set_description("trials")
        trials = (trial for trial in plan.trials() if trial.key not in journal)
        for _, row in workers.run(partial(isolated_trial, settings=settings), trials):
            journal.append(row)
            bar.update()


def _side_by_side(plan: Plan, settings: Settings, journal: Journal) -> None:
    from slam_init.compare.side_by_side import write_side_by_side

    outcomes: dict[tuple[str, int], dict[str, str]] = {}
    for row in journal.rows(plan.holds):
        outcomes.setdefault((row.source, row.start), {})[row.method] = row.outcome
    for source in plan.sources:
        for start in plan.starts(source):
            of_start = outcomes[source.label, start]
            write_side_by_side(source, start, settings, {method: of_start[method] for method in plan.methods})
