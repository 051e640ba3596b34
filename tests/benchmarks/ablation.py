"""What each rule of a decision is worth: the outcomes without it, beside those with all rules.

A rule is left out in a forked process: its function gives there what it gives where it finds nothing. All cases are
decided again: planes at short baselines, cameras on a tripod whose lens zooms, simulated worlds, and starts of the real
sequences below ``SLAM_INIT_DATA``. A rule whose absence costs neither a false map nor right ones goes. ::

    python -m tests.benchmarks.ablation --seeds 300 320 --log ablation.jsonl
    python -m tests.benchmarks.ablation --seeds 10000 10100 --worlds PATH/gen.py --log ablation.jsonl
    python -m tests.benchmarks.ablation --from-log ablation.jsonl --out table.md
"""

import importlib
import inspect
import multiprocessing
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from slam_init.datasets import open_source
from slam_init.datasets.synth import open_points
from slam_init.initializer import Initializer
from slam_init.types.pose import Pose
from slam_init.window.levels import WRONG_DIRECTION_DEG
from slam_init.window.motion import OtherMotion
from slam_init.window.uncertainty import two_directions
from tests.benchmarks.options import append_row, data_folder, program, progress, read_rows, show
from tests.benchmarks.reliability import (
    World,
    built_in,
    by_another_hand,
    commit,
    decide,
    errors_deg,
    is_wrong,
    world_of,
)
from tests.benchmarks.tables import markdown_table

_PLANES, _BASELINES = ("wall", "desk", "nadir", "tilted-30"), (0.03, 0.05, 0.1)
#: Zooms of a lens within the views of a world whose camera stands or turns.
_TRIPODS, _ZOOMS, _ZOOMED_VIEWS = ("static", "rotation", "pan"), (1.05, 1.3), 30
#: Real sequences, with the step between their starts and the most frames of a start; in the last one the camera turns.
_FILM = {
    "lund/door": (1, 12), "kitti/06_start": (5, 30), "strecha/castle-P19": (2, 12), "tsukuba/new_tsukuba_150": (20, 40),
    "planar/checkerboard_desk": (10, 40), "7scenes/redkitchen_a": (20, 40), "tartanair/hospital_clip": (6, 40),
    "tum_rgbd/fr1_desk_9frames": (2, 9), "tum_rgbd/fr1_rpy_b": (4, 40),
}  # fmt: skip


@dataclass(frozen=True)
class Rule:
    """A rule, as a function of a module, and what stands in its place where it is left out."""

    module: str
    function: str
    without: Callable[..., Any]

    def leave_out(self) -> None:
        """Leave the rule out in this process."""
        owner, name = importlib.import_module(f"slam_init.{self.module}"), self.function
        kind, _, method = name.rpartition(".")
        setattr(getattr(owner, kind) if kind else owner, method, self.without)

    @property
    def lines(self) -> int:
        """Lines of the function with its docstring; what it alone calls is not counted."""
        owner: Any = importlib.import_module(f"slam_init.{self.module}")
        for part in self.function.split("."):
            owner = getattr(owner, part)
        return len(inspect.getsource(owner).splitlines())


def _nothing(*_: Any, **__: Any) -> None:
    return None


#: The rules that refuse a window, by their names.
RULES: dict[str, Rule] = {
    "rotation with zooms": Rule("window.risk", "zooming_probability", lambda *_, **__: 0.0),
    "rotation with zooms: their errors": Rule("window.rotation_term", "_with_errors_of_zooms", _nothing),
    "rotation beside moving objects": Rule("window.rotation_term", "_beside_objects", lambda *_: 0.0),
    "rotation: errors that last": Rule("window.rotation_term", "keeps_errors", lambda *_: False),
    "another motion": Rule("window.risk", "other_motion", lambda *_, **__: OtherMotion()),
    "competing": Rule("window.risk", "competing_term", lambda *_: (0.0, None)),
    "direction: a lens that changes": Rule(
        "window.direction_term", "_with_varying_lens",
        lambda sigmas_deg, *_: two_directions(WRONG_DIRECTION_DEG, sigmas_deg),
    ),
    "direction: residuals that neighbours share": Rule(
        "window.direction_term", "variance_by_correlation", lambda *_: 1.0
    ),
    "focal length against the stated one": Rule("decision.focal_check", "FocalCheck.check", _nothing),
    "tracks that stay on the image": Rule("decision.evaluated_window", "static_tracks", lambda *_: np.zeros(0, int)),
    "depths that are known": Rule("decision.window_rule", "depth_gates", lambda *_: []),
    "the map against the motion": Rule(
        "window.risk", "WindowRisk.of_map", lambda risk, *_: risk
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Something to decide: a world of tracks, or a start of a sequence."""

    group: str
    name: str
    world: World | None = None
    start: int = 0


@dataclass(frozen=True)
class Outcome:
    """The decision of a case without a rule."""

    rule: str
    group: str
    name: str
    #: correct, false, none.
    outcome: str
    #: The frames after the first one up to the decision.
    wait: int
    #: CPU of the frame that decides.
    last_ms: float
    commit: str


def cases(seeds: range) -> Iterator[Case]:
    """All cases of some seeds."""
    for seed in seeds:
        for scene in _PLANES:
            for baseline in _BASELINES:
                world = world_of(open_points(f"points:{scene}?baseline={baseline}", seed), {})
                yield Case(f"planes, {baseline:g}", f"{scene} {seed}", world)
        for scene in _TRIPODS:
            for zoom in _ZOOMS:
                world = world_of(open_points(f"points:{scene}?views={_ZOOMED_VIEWS}", seed), {}, no_translation=True)
                yield Case(f"tripods, zoom {zoom:g}", f"{scene} {seed}", _zooming(world, zoom))
        for k, world in enumerate(built_in(seed)):
            yield Case("worlds", f"{seed} {k}", world)


def cases_by_another_hand(path: Path, seeds: range) -> Iterator[Case]:
    """The worlds of a Python file, as of :mod:`tests.benchmarks.reliability`."""
    worlds = by_another_hand(path)
    for seed in seeds:
        for world in worlds(seed):
            yield Case(f"worlds of {path.parent.name}", str(seed), world)


def film() -> Iterator[Case]:
    """The starts of the real sequences that are here."""
    for name, (step, _) in _FILM.items():
        if (data_folder() / name).exists():
            for start in range(0, len(open_source(str(data_folder() / name))) - step, step):
                yield Case(f"film: {name}", str(start), start=start)


def _zooming(world: World, zoom: float) -> World:
    """The world through a lens that zooms by a factor from its first view to its last one."""
    camera, last = world.camera, len(world.views) - 1
    centre, views = np.array([camera.cx, camera.cy]), []
    for k, view in enumerate(world.views):
        pixels = centre + zoom ** (k / last) * (view.pixels - centre)
        inside = ((pixels >= 0) & (pixels <= [camera.width - 1, camera.height - 1])).all(axis=1)
        ids, pixels = view.track_ids[inside], pixels[inside]
        views.append(
            replace(view, track_ids=ids, pixels=pixels, bearings=camera.bearings(pixels), colors=view.colors[inside])
        )
    return replace(world, views=views)


def outcome_of(case: Case) -> tuple[str, int, float]:
    """The outcome of a case, its wait, and the CPU milliseconds of the frame that decides."""
    if case.world is not None:
        begin = time.process_time()
        decision = decide(case.world, 0)
        return decision.outcome, decision.wait, 1e3 * (time.process_time() - begin) / max(decision.wait, 1)
    name = case.group.removeprefix("film: ")
    source, count, last_ms = open_source(str(data_folder() / name)), 0, 0.0
    initializer = Initializer(source.camera)
    for frame in islice(source.frames(case.start), _FILM[name][1]):
        begin = time.process_time()
        done = initializer.process(frame)
        last_ms = 1e3 * (time.process_time() - begin)
        if done:
            break
        count += 1
    if initializer.map is None:
        return "none", count, last_ms
    return _evaluated(initializer, source), count, last_ms


def _evaluated(initializer: Initializer, source: Any) -> str:
    truth: dict[int, Pose] = {}
    assert initializer.map is not None
    for one in initializer.map.keyframes:
        pose = source.groundtruth.at(one.timestamp_s)
        if pose is not None:
            truth[one.frame] = pose
    frames = [one for one in initializer.map.keyframes if one.frame in truth]
    errors = errors_deg(replace(initializer.map, keyframes=tuple(frames)), truth)
    still = World(initializer.map.camera, [], truth, "rpy" in source.name, {}, np.zeros((0, 3)))
    return "false" if is_wrong(errors, still) else "correct"


_cases: list[Case] = []


def _decide_all(rule: str) -> list[Outcome]:
    """The outcomes of all cases without a rule; with all rules where its name is empty."""
    if rule:
        RULES[rule].leave_out()
    found, version = [], commit()
    for case in _cases:
        try:
            outcome = outcome_of(case)
        except (ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError):
            outcome = ("fails", 0, 0.0)
        found.append(Outcome(rule, case.group, case.name, *outcome, version))
    return found


def measure(log: Path, rules: Sequence[str], jobs: int) -> None:
    """Decide all cases without each rule, and add a line for each decision to the log."""
    context = multiprocessing.get_context("fork")
    with context.Pool(jobs, maxtasksperchild=1) as pool:
        for found in progress(pool.imap(_decide_all, ["", *rules]), "rules", len(rules) + 1):
            for one in found:
                append_row(log, one)


def report(log: Path) -> str:
    """The table: a row a rule, a column a group; in each cell what differs from the outcomes with all rules."""
    found = read_rows(log, Outcome)
    groups, rules = list(dict.fromkeys(one.group for one in found)), list(dict.fromkeys(one.rule for one in found))
    rows = []
    for rule in rules:
        of_rule = [one for one in found if one.rule == rule]
        cells = [_cell([one for one in of_rule if one.group == group]) for group in groups]
        maps = [one.last_ms for one in of_rule if one.outcome in ("correct", "false") and one.group.startswith("film")]
        lines = str(RULES[rule].lines) if rule else "-"
        rows.append([rule or "all rules", *cells, f"{np.median(maps):.0f}" if maps else "-", lines])
    head = ["without", *groups, "frame with the map, ms", "lines of the function"]
    commits = ", ".join(sorted({one.commit for one in found}))
    return f"Command: `python -m tests.benchmarks.ablation`. Commit: {commits}.\n\n{markdown_table(head, rows)}\n"


def _cell(group: Sequence[Outcome]) -> str:
    """Correct, false, none, and the mean wait of the maps."""
    counts = Counter(one.outcome for one in group)
    waits = [one.wait for one in group if one.outcome in ("correct", "false")]
    wait = f", {np.mean(waits):.2f}" if waits else ""
    return f"{counts['correct']}/{counts['false']}/{counts['none'] + counts['fails']}{wait}"


def main() -> None:
    """Measure and print the table."""
    parser = program("ablation", __doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(300, 320), metavar=("FIRST", "END"))
    parser.add_argument("--worlds", type=Path, metavar="FILE", help="only the worlds of these seeds by another hand")
    parser.add_argument("--rules", nargs="+", choices=RULES, default=list(RULES), metavar="RULE", help="by default all")
    parser.add_argument("--jobs", type=int, default=2, metavar="N")
    parser.add_argument("--log", type=Path, default=Path("ablation.jsonl"), metavar="FILE", help="lines are appended")
    parser.add_argument("--from-log", type=Path, metavar="FILE", help="the table of a log; run nothing")
    options = parser.parse_args()
    if options.from_log is None:
        seeds = range(*options.seeds)
        if options.worlds is not None:
            _cases.extend(cases_by_another_hand(options.worlds, seeds))
        else:
            _cases.extend([*cases(seeds), *film()])
        measure(options.log, options.rules, options.jobs)
    show(report(options.from_log or options.log), options.out)


if __name__ == "__main__":
    main()
