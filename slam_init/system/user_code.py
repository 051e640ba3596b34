"""An attribute of the user's own code, named by module or by file."""

from __future__ import annotations

import sys
from hashlib import blake2b
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from slam_init.errors import place_of


def attribute_of(text: str) -> Any:
    """Import ``package.module:attribute`` or ``folder/file.py:attribute``.

    Whatever the code raises while it is imported is raised here, also a SystemExit: ImportError and AttributeError for
    names that do not exist.
    """
    place, _, attribute = text.rpartition(":")
    module = _module_of(Path(place)) if place.endswith(".py") else import_module(place)
    if not hasattr(module, attribute):
        raise AttributeError(f"{place} has no attribute {attribute!r}")
    return getattr(module, attribute)


def described_error(error: BaseException) -> str:
    """What an error of the user's code says, and where, in one line. An error without a text is named by its type."""
    return (" ".join(str(error).split()) or type(error).__name__) + place_of(error)


def _module_of(file: Path) -> ModuleType:
    """The module of a file. It is executed once a process, so that its classes stay the same."""
    path = file.resolve()
    name = f"slam_init_user_{path.stem}_{blake2b(bytes(path), digest_size=8).hexdigest()}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ImportError(f"there is no file {file}")
    module = sys.modules[name] = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
