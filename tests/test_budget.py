"""No folder exceeds its budget of lines of code (``[tool.slam_init.budget]`` of ``pyproject.toml``)."""

import ast
import io
import tokenize
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


def code_lines(text):
    """The number of lines that hold code: neither blank, nor a comment, nor a docstring alone."""
    docstrings = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and type(first.value.value) is str:
                docstrings |= set(range(first.lineno, first.end_lineno + 1))
    coded = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            coded |= set(range(token.start[0], token.end[0] + 1))
    return len(coded - docstrings)


def test_code_lines_leave_out_what_only_explains():
    text = '"""A module."""\n# why\n\nx = """a\nb"""\n\n\ndef f():\n    """Say."""\n    return (1,\n  2)\n'
    assert code_lines(text) == 5


def test_no_folder_exceeds_its_budget():
    budget = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["slam_init"]["budget"]
    over = {}
    for name, most in budget.items():
        folder, own = ROOT / name.removesuffix("/*"), name.endswith("/*")
        found = sum(code_lines(path.read_text()) for path in folder.glob("*.py" if own else "**/*.py"))
        if found > most:
            over[name] = f"{found} of {most}"
    assert not over, "lines of code above the budget"
    packages = {f"slam_init/{path.name}" for path in (ROOT / "slam_init").iterdir() if (path / "__init__.py").is_file()}
    assert packages <= set(budget)
