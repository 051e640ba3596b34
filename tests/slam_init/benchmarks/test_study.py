"""The study: worlds from the stated distribution, tables that count what trials say, two adjustments of one start."""

from dataclasses import replace
from urllib.parse import parse_qsl

import numpy as np
import pytest

from slam_init.benchmarks import study, study_ablation
from slam_init.benchmarks.map_quality import adjusted_by_pycolmap, errors_of
from slam_init.benchmarks.study_ablation import VARIANTS, Variant, ablation_cells, run_ablation
from slam_init.benchmarks.study_oracle import solvable_worlds, true_problem
from slam_init.benchmarks.study_parts import NOISES_PX, PARTS, Cell, sources_of
from slam_init.benchmarks.study_tables import counts_text, frames_to_correct, grid_table, moving_table, still_table
from slam_init.compare.sources import GRID, open_compared
from slam_init.compare.trials import COLUMNS
from slam_init.config import Config
from slam_init.types.pose import Pose


def options_of(text):
    return {key: float(value) for key, value in parse_qsl(text.partition("?")[2])}


def row(source, method, outcome, frames=None, **more):
    blank = dict.fromkeys(COLUMNS)
    return blank | {
        "source": source, "method": method, "outcome": outcome, "frames_to_accept": frames, "frames_limit": 12,
        "strict": outcome == "correct", "reason": "low_parallax" if outcome == "none" else None, **more,
    }  # fmt: skip


def table_cells(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


# -- worlds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PARTS)
def test_worlds_are_distinct_and_lie_in_the_stated_distribution(name):
    for cell in PARTS[name].cells(7, seed=3):
        assert len(set(cell.sources)) == len(cell.sources) == 7
        for options in map(options_of, cell.sources):
            assert options["noise_px"] in NOISES_PX
            assert options["baseline"] in GRID["baseline"]
            assert 0.05 <= options["outliers"] <= 0.3
            assert abs(options["focal_error"]) in (0.0, 0.05)


def test_a_world_that_is_in_two_cells_is_run_once():
    """A world that drew 1 px is the very one whose noise is fixed at 1 px."""
    cells = PARTS["hard"].cells(12, seed=0)
    texts = [text for cell in cells for text in cell.sources]
    assert {source.text for source in sources_of(cells)} == set(texts)
    assert len(sources_of(cells)) < len(texts)


def test_a_camera_with_another_focal_length_sees_the_same_world():
    cells = {cell.name: cell for cell in PARTS["still"].cells(1, seed=0)}
    right, wrong = (
        open_compared(cells[f"rotation, {name}"].sources[0]).sequence for name in ("true focal length", "5 % too long")
    )
    np.testing.assert_array_equal(right.pixels, wrong.pixels)
    assert wrong.camera.fx == pytest.approx(1.05 * right.camera.fx)


def test_a_variant_differs_from_the_method_in_what_its_name_says():
    whole = VARIANTS[0]
    assert (whole.method, whole.config) == ("quest", Config())
    assert len({variant.name for variant in VARIANTS}) == len(VARIANTS)
    assert all((variant.method, variant.config) != ("quest", Config()) for variant in VARIANTS[1:])
    for cell in ablation_cells(2, seed=0):
        assert len(set(cell.sources)) == len(cell.sources)
        assert all(open_compared(text).groundtruth is not None for text in cell.sources[:1])


# -- tables ----------------------------------------------------------------------------------------


def test_a_trial_without_a_correct_map_counts_as_its_limit():
    rows = [row("a", "m", "correct", 4), row("b", "m", "false", 3), row("c", "m", "none"), row("d", "m", "error")]
    assert frames_to_correct(rows) == [4.0, 12.0, 12.0, 12.0]
    assert counts_text(rows) == "1 / 1 / 2"


def test_every_variant_runs_every_world_once_from_its_beginning(tmp_path, monkeypatch):
    variants = (Variant("quest", "essential-8pt"), Variant("one reference frame", "essential-8pt", VARIANTS[4].config))
    for name, value in (("VARIANTS", variants), ("GENERAL", ("room",)), ("PLANAR", ("wall",))):
        monkeypatch.setattr(study_ablation, name, value)
    whole, variant = table_cells(run_ablation(tmp_path, 1, 0, 1, progress=False))
    trials = sum(len(cell.sources) for cell in ablation_cells(1, 0))
    for cells, folder in ((whole, "quest"), (variant, "one-reference-frame")):
        assert sum(int(n) for cell in cells[1:5] for n in cell.split(" / ")) == trials
        assert (tmp_path / folder / "trials.jsonl").read_text().count("\n") == 1 + trials
    # a method of two views from the first frame on knows no window of references
    assert (whole[0], variant[0], variant[8]) == ("nothing", "one reference frame", "0 : 0")


def test_methods_are_compared_on_the_same_worlds():
    """Four worlds: both solve the first, one each the second and the third, nobody the last."""
    outcomes = {"quest": ("correct", "correct", "none", "none"), "other": ("correct", "false", "correct", "none")}
    rows = {
        (source, method): row(source, method, outcome, 6 if method == "quest" else 3)
        for method, given in outcomes.items()
        for source, outcome in zip("abcd", given, strict=True)
    }
    rows["d", "quest"] |= {"reason": "ambiguous_plane", "kept_truth": True}
    ours, other, *together = table_cells(moving_table([Cell("wall", tuple("abcd"))], rows, ("quest", "other")))
    assert ours[:3] == ["wall", "quest", "4"]
    assert ours[3].startswith("50.0 [")
    assert ours[6:8] == ["2 (1 ambiguous_plane, 1 low_parallax)", "1 of 1"]
    # of three worlds that one of them solves, each solves two
    assert ours[8] == other[8]
    assert ours[8].startswith("66.7 [")
    # 6 6 12 12 against 3 12 3 12
    assert (ours[9], other[9]) == ("9.00", "7.50")
    assert other[10].startswith("-1.50 [")
    assert [cells[2:] for cells in together] == [ours[2:], other[2:]]


def test_still_worlds_tell_false_maps_reasons_and_suspicions():
    rows = {
        ("a", "quest"): row(
            "a", "quest", "none", reason="pure_rotation", reason_right=True, suspected_focal_factor=0.9
        ),
        ("b", "quest"): row("b", "quest", "false", 5, reason_right=False),
    }
    (cells,) = table_cells(still_table([Cell("rotation", ("a", "b"))], rows, ("quest",)))
    shares = [cell.partition(" ")[0] for cell in cells]
    assert shares[3:] == ["50.0", "1", "50.0", "50.0", "0.0"]


def test_noise_against_baseline_has_a_row_a_noise_and_a_column_a_baseline():
    cells = PARTS["noise-baseline"].cells(1, seed=0)
    rows = {(text, "quest"): row(text, "quest", "correct", 3) for cell in cells for text in cell.sources}
    solvable = {text for cell in cells for text in cell.sources if "points:room" in text}
    tables = grid_table(cells, rows, "quest", solvable).split("\n\n")
    for (scene, told), table in zip((("room", "1 / 0 / 0 (1)"), ("wall", "1 / 0 / 0 (0)")), tables, strict=True):
        assert table.startswith(f"| {scene}")
        assert [line[1:] for line in table_cells(table)] == [[told] * len(GRID["baseline"])] * len(NOISES_PX)


def test_a_world_is_solvable_with_a_long_way_and_not_where_noise_drowns_the_parallax():
    pytest.importorskip("pycolmap")
    much, little = "points:wall?noise_px=0.3&baseline=0.3&seed=1", "points:wall?noise_px=20&baseline=0.002&seed=1"
    assert solvable_worlds([much, little]) == {much}


# -- the command -----------------------------------------------------------------------------------


def test_the_command_prints_and_writes_the_table_and_runs_nothing_twice(tmp_path, capsys):
    options = ["--out", str(tmp_path), "--trials", "1", "--part", "general", "--methods", "essential-8pt,stella"]
    assert study.main(options) == 0
    shown = capsys.readouterr().out
    assert shown.strip() == (tmp_path / "general.md").read_text().strip()
    trials = (tmp_path / "general" / "trials.jsonl").read_bytes()
    assert study.main(options) == 0
    assert capsys.readouterr().out == shown
    assert (tmp_path / "general" / "trials.jsonl").read_bytes() == trials


def test_what_is_wrong_is_told_in_one_line(tmp_path, capsys):
    assert study.main(["--out", str(tmp_path), "--methods", "magic"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


# -- bundle adjustment -----------------------------------------------------------------------------


def off(problem):
    """The problem from a start that is off by a twentieth."""
    rng = np.random.default_rng(0)
    first, *others = problem.world_from_cam
    return replace(
        problem,
        world_from_cam=(first, *(Pose(pose.R, pose.t * rng.uniform(0.95, 1.05, 3)) for pose in others)),
        points=problem.points * rng.uniform(0.95, 1.05, (len(problem.points), 1)),
    )


@pytest.mark.parametrize("robust", [False, True])
def test_pycolmap_finds_the_truth_from_a_start_that_is_off(robust):
    pytest.importorskip("pycolmap")
    source = open_compared("points:room?noise_px=0&outliers=0&seed=4")
    start = off(true_problem(source))
    if robust:  # every seventh landmark is seen elsewhere in the last view
        wild = (start.views == 2) & (start.landmarks % 7 == 0)
        start = replace(start, pixels=np.where(wild[:, None], start.pixels + np.array([40.0, -25.0]), start.pixels))
    found = adjusted_by_pycolmap(source.camera, start, robust=robust)
    before, after = (errors_of(source, problem, found.track_ids) for problem in (start, found))
    assert before.direction_deg > 0.5
    assert before.depth > 0.01
    assert after.rotation_deg < 1e-4
    assert after.direction_deg < 1e-2
    assert after.depth < 1e-4
