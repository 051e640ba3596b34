"""Counts correct and false initializations: ``python -m tests.benchmarks.initialization``.

The program compares ``quest`` alone (:mod:`slam_init.compare`): on every real sequence below ``SLAM_INIT_DATA`` (a
folder with ``camera.yaml`` and ``groundtruth.txt``), from its first frame to its end, and on several seeds of every
synthetic scene. It prints one table of each. :mod:`slam_init.compare.criteria` states what makes a map correct or
false.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from sequences_synth import SCENES, STANDARD_SCENES
from slam_init.compare.rows import TrialRow
from slam_init.compare.run import compare
from slam_init.compare.sources import describe_sources
from slam_init.compare.trials import Plan, Settings
from tests.benchmarks.image_pairs import find_sequences
from tests.benchmarks.options import data_folder, program, show
from tests.benchmarks.tables import markdown_table, number, read_journal

#: A run has no limit but the end of its sequence.
_ALL_FRAMES, _ALL_SECONDS, _ONE_START = 1_000_000, 1e6, 1_000_000


def run_all(texts: Sequence[str], jobs: int) -> list[TrialRow]:
    """Run ``quest`` on sources from their first frame; the rows are in the order of the sources."""
    sources = tuple(describe_sources(texts))
    settings = Settings(limit_frames=_ALL_FRAMES, limit_s=_ALL_SECONDS, time_limit_s=3600)
    with tempfile.TemporaryDirectory() as folder:
        compare(Plan(sources, ("quest",), every=_ONE_START, settings=settings), folder, jobs=jobs, progress=True)
        rows = {row.source: row for row in read_journal(Path(folder) / "trials.jsonl")}
    return [rows[source.label] for source in sources]


def _class(row: TrialRow) -> str:
    return "strict" if row.strict else row.outcome


def real_table(rows: Sequence[TrialRow], data: Path) -> str:
    """Make the table of the real sequences. A direction that the ground truth does not tell is left out."""
    header = ["sequence", "result", "class", "frames to init", "rotation (deg)", "direction (deg)"]
    header += ["landmarks", "parallax (deg)", "reprojection rmse (px)"]
    lines = []
    for row in rows:
        name = Path(row.source).relative_to(data).as_posix()
        errors = (number(row.rotation_error_deg), number(row.direction_error_deg))
        figures = (number(row.landmarks, 0), number(row.parallax_deg), number(row.reprojection_rmse_px))
        frames = number(row.frames_to_accept, 0)
        lines.append([name, row.reason or "initialized", _class(row), frames, *errors, *figures])
    return markdown_table(header, lines)


def count_table(rows: Sequence[TrialRow]) -> str:
    """Make the table of the scenes: their runs by class, and the reasons."""
    header = ["scene", "runs", "correct", "of which strict", "false", "none", "reasons", "median frames to init"]
    groups: dict[str, list[TrialRow]] = {}
    for row in rows:
        groups.setdefault(row.group.removeprefix("synth:"), []).append(row)
    lines = [[name, *_counts(group)] for name, group in groups.items()]
    return markdown_table(header, [*lines, ["all", *_counts(rows)]] if len(groups) > 1 else lines)


def _counts(rows: Sequence[TrialRow]) -> list[str]:
    classes = Counter(map(_class, rows))
    reasons = Counter(row.reason for row in rows if row.reason is not None)
    frames = [row.frames_to_accept for row in rows if row.frames_to_accept is not None]
    counts = (len(rows), classes["correct"] + classes["strict"], classes["strict"], classes["false"], classes["none"])
    message = ", ".join(f"{count} {reason}" for reason, count in reasons.most_common()) or "-"
    return [*map(str, counts), message, f"{median(frames):g}" if frames else "-"]


def main() -> int:
    """Print the tables; return the exit code."""
    parser = program("initialization", __doc__)
    parser.add_argument("--only", choices=("real", "synthetic"), help="one of the two tables")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="of each scene (default: 10)")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(STANDARD_SCENES), metavar="SCENE")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    options = parser.parse_args()
    data, tables = data_folder().resolve(), []
    if options.only != "synthetic":
        if found := [str(data / name) for name in find_sequences(data)]:
            tables.append(real_table(run_all(found, options.jobs), data))
        else:
            print(f"no sequence below {data}: set SLAM_INIT_DATA to a folder of sequences", file=sys.stderr)
    if options.only != "real":
        worlds = [f"synth:{scene}?seed={seed}" for scene in options.scenes for seed in range(options.seeds)]
        tables.append(count_table(run_all(worlds, options.jobs)))
    if tables:
        show("\n\n".join(tables) + "\n", options.out)
    return 0 if tables else 2


if __name__ == "__main__":
    sys.exit(main())
