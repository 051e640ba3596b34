"""Monocular SLAM initialization: from a video to a bundle-adjusted map, on planes too, or a reason why not.

The public names stand in ``__init__.pyi``, for people, type checkers and this module (SPEC 1). They
are loaded when they are first used, so that ``import slam_init`` and the command line stay quick.
Attempts and refusals are reported to the logger ``slam_init`` at the levels INFO and DEBUG; the library prints nothing.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text())
_HOMES = {
    alias.name: str(statement.module)
    for statement in _STUB.body
    if isinstance(statement, ast.ImportFrom)
    for alias in statement.names
}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("slam-init")
        except PackageNotFoundError:
            return "0+unknown"
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'slam_init' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
