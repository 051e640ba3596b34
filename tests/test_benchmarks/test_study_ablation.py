"""The ablation runs variants of the method on the same worlds."""

from comparisons import table_cells

from slam_init.compare.sources import open_compared
from slam_init.config import Config
from tests.benchmarks import study_ablation
from tests.benchmarks.study_ablation import VARIANTS, Variant, ablation_cells, run_ablation


def test_every_variant_differs_from_the_whole_method():
    whole = VARIANTS[0]
    assert (whole.method, whole.config) == ("quest", Config())
    assert len({variant.name for variant in VARIANTS}) == len(VARIANTS)
    assert all((variant.method, variant.config) != ("quest", Config()) for variant in VARIANTS[1:])
    for cell in ablation_cells(2, seed=0):
        assert len(set(cell.sources)) == len(cell.sources)
        assert all(open_compared(text).groundtruth is not None for text in cell.sources[:1])


def test_every_variant_runs_every_world_once_from_its_first_frame(tmp_path, monkeypatch):
    variants = (Variant("quest", "essential-8pt"), Variant("one reference frame", "essential-8pt", VARIANTS[2].config))
    for name, value in (("VARIANTS", variants), ("GENERAL", ("room",)), ("PLANAR", ("wall",))):
        monkeypatch.setattr(study_ablation, name, value)
    whole, variant = table_cells(run_ablation(tmp_path, 1, 0, 1, progress=False))
    trials = sum(len(cell.sources) for cell in ablation_cells(1, 0))
    for cells, folder in ((whole, "quest"), (variant, "one-reference-frame")):
        assert sum(int(n) for cell in cells[1:5] for n in cell.split(" / ")) == trials
        assert (tmp_path / folder / "trials.jsonl").read_text().count("\n") == 1 + trials
    # essential-8pt does not use a window of references, so both variants solve the same worlds
    assert (whole[0], variant[0], variant[8]) == ("nothing", "one reference frame", "0 : 0")
