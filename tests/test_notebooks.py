"""The notebooks are their scripts, executed: each script runs as it stands, and each notebook has its cells."""

import json
from contextlib import chdir

import pytest
from makers import maker

pytestmark = pytest.mark.docs

notebooks = maker("notebooks")
SCRIPTS = sorted(notebooks.NOTEBOOKS.glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_notebook_runs_and_has_the_cells_of_its_script(script, tmp_path):
    with chdir(tmp_path):
        executed = list(notebooks.execute(script))
    stored = json.loads(script.with_suffix(".ipynb").read_text(encoding="utf-8"))
    assert (stored["nbformat"], stored["nbformat_minor"]) == (4, 5)
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in stored["cells"]]
    assert cells == [(kind, text) for kind, text, _ in executed], f"run python docs/make/notebooks.py {script.stem}"
    for cell, (_, _, outputs) in zip(stored["cells"], executed, strict=True):
        kinds = [output["output_type"] for output in cell.get("outputs", [])]
        assert kinds == [output["output_type"] for output in outputs]
