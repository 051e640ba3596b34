"""Runs a whole comparison: tracks, trials, result files."""

from __future__ import annotations

import csv
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

from slam_init.compare.backends import DASK, Backend, open_backend
from slam_init.compare.isolation import end_process, isolated_tracks, isolated_trials
from slam_init.compare.plan import Plan
from slam_init.compare.recordings import RECORDINGS
from slam_init.compare.rows import COLUMNS, Journal, TrialRow
from slam_init.compare.summary import ComparisonSummary, summary_of
from slam_init.compare.trajectories import TRAJECTORIES
from slam_init.compare.trial_table import TrialTable
from slam_init.compare.trials import Settings
from slam_init.datasets.points import POINTS
from slam_init.datasets.views import SourceView
from slam_init.errors import OutputError
from slam_init.output.folder import OutputFolder, output_error
from slam_init.output.names import COMPARE_FILES, DIGESTS, TRIALS, UNFINISHED
from slam_init.output.plain_json import Json

#: Digest of the tracks by the label of the source.
Digests: TypeAlias = Mapping[str, str]
MakeTexts: TypeAlias = Callable[[TrialTable, Plan, Digests], Mapping[str, str]]
_RESULTS, _SUMMARY, _REPORT = "results.csv", "summary.json", "report.html"
#: Least number of batches for each worker.
_BATCHES_PER_WORKER = 8


@dataclass(frozen=True)
class Extras:
    """What a benchmark adds to a comparison."""

    #: The command that the folder of the results belongs to.
    command: str = "compare"
    #: Names of the further files. With :data:`DIGESTS` among them the digests of the tracks are stored.
    files: tuple[str, ...] = ()
    #: Whether the trials write their trajectories.
    trajectories: bool = False
    #: Takes the trials, the plan and the digests, and returns the content of further files by name.
    texts: MakeTexts = lambda *_: {}


_NO_EXTRAS = Extras()


def compare(
    plan: Plan,
    out: str | os.PathLike[str],
    *,
    backend: str = "loky",
    jobs: int = 1,
    recordings: bool = False,
    progress: bool = False,
    command: str = "",
    extras: Extras = _NO_EXTRAS,
) -> ComparisonSummary:
    """Run all trials that ``out`` does not hold yet, and write the results.

    * ``out``: Folder of ``trials.jsonl``, ``results.csv``, ``summary.json``, ``report.html`` and the recordings: a new
      or an empty one, or one of an earlier comparison. Earlier results stay until all trials have ended.
    * ``backend``: ``loky``, ``sequential`` or ``dask:ADDRESS``, see :func:`slam_init.compare.backends.open_backend`.
    """
    path = Path(out)
    targets = (*COMPARE_FILES, *extras.files)
    with OutputFolder(path, extras.command, targets) as folder, _tracks_folder(folder, backend) as tracks:
        recorded = str((path / RECORDINGS).resolve()) if recordings else None
        posed = str((path / TRAJECTORIES).resolve()) if extras.trajectories else None
        settings = replace(plan.settings, tracks=tracks, recordings=recorded, trajectories=posed)
        claimed = [TRIALS, *({DIGESTS} & {*extras.files})]
        claimed += plan.recordings() if recordings else ()
        claimed += plan.trajectories() if extras.trajectories else ()
        folder.claim(claimed)
        _remove_unfinished(folder)
        digests = StoredDigests(path / DIGESTS if DIGESTS in extras.files else None)
        with Journal(path / TRIALS, _shared_settings(plan, settings), partial(_is_current, plan)) as journal:
            try:
                with open_backend(backend, jobs, _paths(plan)) as workers:
                    _run_trials(plan, settings, journal, workers, progress, digests)
            finally:
                end_process()  # that of the sequential backend
            if recordings:
                _side_by_side(plan, settings, journal)
            return _publish(folder, journal.rows(plan.holds), plan, command, extras, digests.known)


def _paths(plan: Plan) -> list[str]:
    """The files and folders that the trials read."""
    parsed = [SourceView.parse(source.text) for source in plan.sources]
    texts = {text for view, source in parsed for text in (source, view.mask, view.camera) if text is not None}
    return sorted(text for text in texts if Path(text).is_absolute())


def _remove_unfinished(folder: OutputFolder) -> None:
    """Remove recordings of trials that were killed."""
    try:
        for name in folder.files:
            if name.endswith(UNFINISHED):
                (folder.path / name).unlink(missing_ok=True)
    except OSError as error:
        raise output_error(folder.path, error) from error


@contextmanager
def _tracks_folder(folder: OutputFolder, backend: str) -> Iterator[str]:
    """Make the folder of the tracks: below that of the results, which the next command clears after a kill.

    The workers of a cluster may be on other machines, where only the folder of temporary files is sure to be there.
    """
    if not backend.startswith(DASK):
        tracks_folder = (folder.staging / "tracks").resolve()
        try:
            # A worker that finds none makes it, and takes it away when it ends, while others read from it.
            tracks_folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(folder.path, error) from error
        yield str(tracks_folder)
        return
    try:
        tracks = tempfile.mkdtemp(prefix="slam-init-tracks-")
    except OSError as error:
        raise OutputError(f"cannot write temporary files: {error.strerror or error}: make room") from error
    try:
        yield tracks
    finally:
        shutil.rmtree(tracks, ignore_errors=True)


def _shared_settings(plan: Plan, settings: Settings) -> dict[str, Json]:
    """Return the settings that must be equal for all rows of a results folder."""
    views = {SourceView.parse(source.text)[0].query for source in plan.sources} - {""}
    # Rows that were not audited lack a figure.
    audit: dict[str, Json] = {"audit": True} if settings.audit else {}
    view: dict[str, Json] = {"view": ", ".join(sorted(views))} if views else {}
    return (
        view
        | audit
        | {
            "seed": settings.seed,
            "limit_frames": settings.limit_frames,
            "limit_s": settings.limit_s,
            # The limits of external programs do not change the result of a trial, unless it is an error.
            "options": {
                name: value
                for name, value in asdict(replace(settings.config, method="", seed=0)).items()
                if name != "external"
            },
        }
    )


def _is_current(plan: Plan, row: TrialRow) -> bool:
    """Return whether a stored row was judged by the criteria of this version; the trial is run again otherwise."""
    criteria = plan.criteria.get(row.source)
    return criteria is None or criteria.judged(row.judged_by)


def _run_trials(
    plan: Plan, settings: Settings, journal: Journal, workers: Backend, progress: bool, digests: StoredDigests
) -> None:
    """Run the trials that the journal lacks, after the tracks of their sources."""
    from tqdm import tqdm

    missing = sum(trial.key not in journal for trial in plan.trials())
    with tqdm(total=missing, unit="trial", desc="tracks", disable=not progress, leave=False) as bar:
        unfinished = {trial.source.text for trial in plan.trials() if trial.key not in journal}
        tracked = sorted(text for text in unfinished if not text.startswith(POINTS))
        labels = {source.text: source.label for source in plan.sources}
        for text, digest in workers.run(partial(isolated_tracks, settings=settings), tracked):
            digests.add(labels[text], digest)
            bar.refresh()
        bar.set_description("trials")
        batches = plan.batches(lambda key: key not in journal, _batch_size(missing, workers))
        for _, rows in workers.run(partial(isolated_trials, settings=settings), batches):
            for row in rows:
                journal.append(row)
            bar.update(len(rows))


def _batch_size(trials: int, workers: Backend) -> int:
    """Choose the number of trials in a task: no more than the backend wants, and few enough to keep all workers busy.

    A worker that gets its last batch when all others end keeps them waiting for one eighth of the time at most.
    """
    return max(1, min(workers.largest_batch, trials // (_BATCHES_PER_WORKER * workers.workers)))


def _side_by_side(plan: Plan, settings: Settings, journal: Journal) -> None:
    from slam_init.compare.side_by_side import write_side_by_side

    outcomes: dict[tuple[str, int], dict[str, str]] = {}
    for row in journal.rows(plan.holds):
        outcomes.setdefault((row.source, row.start), {})[row.method] = row.outcome
    for source in plan.sources:
        for start in plan.starts(source):
            of_start = outcomes[source.label, start]
            shown = {method: of_start[method] for method in plan.methods_on(source)}
            write_side_by_side(source, start, settings, shown)


class StoredDigests:
    """The digests of the tracks, on disk: a run that is resumed does not compute the tracks of finished trials.

    * ``path``: None keeps them in memory only.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.known: dict[str, str] = {}
        for line in path.read_text(encoding="utf-8").splitlines() if path is not None and path.is_file() else ():
            with suppress(ValueError, TypeError):  # the process was killed while it wrote this line
                label, digest = json.loads(line)
                self.known[str(label)] = str(digest)

    def add(self, label: str, digest: str) -> None:
        """Add the digest of a source."""
        if self.known.get(label) == digest:
            return
        self.known[label] = digest
        if self._path is None:
            return
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([label, digest]) + "\n")
        except OSError as error:
            raise OutputError(f"cannot write {self._path}: {error.strerror}: make room") from error


def _publish(
    folder: OutputFolder, rows: Iterable[TrialRow], plan: Plan, command: str, extras: Extras, digests: Digests
) -> ComparisonSummary:
    """Write all result files: either all are replaced, or none. The rows are read once and are not kept in memory."""
    from slam_init.compare.report import report_html

    try:
        with (folder.staging / _RESULTS).open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            table = TrialTable.read(_written(rows, writer.writerow))
        summary = summary_of(table, plan)
        texts = {
            _REPORT: report_html(table, summary, plan, command),
            **extras.texts(table, plan, digests),
            _SUMMARY: json.dumps(summary.as_dict(), indent=2, allow_nan=False) + "\n",
        }
        for name, text in texts.items():
            # File names need not be valid Unicode.
            (folder.staging / name).write_bytes(text.encode("utf-8", "backslashreplace"))
    except OSError as error:
        raise output_error(folder.path, error) from error
    folder.publish([_RESULTS, *texts])
    return summary


def _written(rows: Iterable[TrialRow], write: Callable[[Sequence[object]], object]) -> Iterator[TrialRow]:
    """Write rows to a table, and pass them on."""
    for row in rows:
        write([str(value).lower() if isinstance(value, bool) else value for value in row.values()])
        yield row
