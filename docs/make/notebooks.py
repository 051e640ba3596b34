"""Makes the notebooks of ``docs/notebooks`` from the scripts beside them, executed.

A script has its title in the docstring, ``# %%`` before a cell of code, and ``# %% [markdown]`` before a text in
comments. Run it as ``python docs/make/notebooks.py [NAME ...]`` after a script has changed.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
#: A picture of 400 x 320 pixels: a notebook stays below 100 kB.
_DPI = 80


def cells_of(script: Path) -> list[tuple[str, str]]:
    """Read a script: the kind (``markdown`` or ``code``) and the text of each cell."""
    text = script.read_text(encoding="utf-8")
    cells = [("markdown", str(ast.get_docstring(ast.parse(text))))]
    for part in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        head, _, body = part.partition("\n")
        markdown = head.strip() == "[markdown]"
        body = re.sub(r"^# ?", "", body.strip(), flags=re.MULTILINE) if markdown else body.strip()
        cells.append(("markdown" if markdown else "code", body))
    return cells


def execute(script: Path) -> Iterator[tuple[str, str, list[dict[str, Any]]]]:
    """Execute the cells of a script in one name space, in the current folder.

    * Returns: Kind, text and outputs of each cell: what it printed, and the pictures that it drew.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    names: dict[str, Any] = {"__name__": "__main__"}
    for number, (kind, text) in enumerate(cells_of(script)):
        outputs: list[dict[str, Any]] = []
        if kind == "code":
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile(text, f"{script.name}, cell {number}", "exec"), names)
            if printed.getvalue():
                outputs.append({"output_type": "stream", "name": "stdout", "text": _lines(printed.getvalue())})
            for figure in map(plt.figure, plt.get_fignums()):
                drawn = io.BytesIO()
                figure.savefig(drawn, dpi=_DPI, bbox_inches="tight")
                data = {"image/png": base64.b64encode(drawn.getvalue()).decode()}
                outputs.append({"output_type": "display_data", "data": data, "metadata": {}})
            plt.close("all")
        yield kind, text, outputs


def notebook(script: Path) -> dict[str, Any]:
    """Execute a script in an empty folder, and return it as a notebook (nbformat 4.5)."""
    cells: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for number, (kind, text, outputs) in enumerate(execute(script)):
            cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": _lines(text)}
            if kind == "code":
                count = 1 + sum(one["cell_type"] == "code" for one in cells)
                cell |= {"execution_count": count, "outputs": outputs}
            cells.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def main(names: list[str]) -> None:
    """Write the notebooks of some scripts, by default of all."""
    for script in sorted(NOTEBOOKS.glob("*.py")):
        if not names or script.stem in names:
            content = json.dumps(notebook(script), indent=1, ensure_ascii=False)
            script.with_suffix(".ipynb").write_text(content + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
