"""An attribute of the user's own code, named by module or by file."""

from __future__ import annotations

import sys
import sysconfig
from hashlib import blake2b
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from traceback import extract_tb
from types import ModuleType
from typing import Any

#: Folders of code that is not the user's: this package, Python, and what is installed.
_OF_OTHERS = {
    Path(__file__).resolve().parents[1],
    *(Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "purelib", "platlib")),
}


def attribute_of(text: str) -> Any:
    """Import ``package.module:attribute`` or ``folder/file.py:attribute``.

    Whatever the code raises while it is imported is raised here, also a SystemExit: ImportError and AttributeError for
    names that do not exist.
    """
    place, _, attribute = text.rpartition(":")
    module = _module_of(Path(place)) if place.endswith(".py") else import_module(place)
    try:
        return getattr(module, attribute)
    except AttributeError:
        raise AttributeError(f"{place} has no attribute {attribute!r}") from None


def described_error(error: BaseException) -> str:
    """What an error of the user's code says, and where, in one line. An error without a text is named by its type."""
    return (" ".join(str(error).split()) or type(error).__name__) + place_of(error)


def place_of(error: BaseException) -> str:
    """The innermost line of the user's code that an error passed, as ``(my_method.py:14)``; empty where there is none.

    A space stands before it.
    """
    lines = [(Path(at.filename), at.lineno) for at in extract_tb(error.__traceback__)]
    own = [
        (path, line) for path, line in lines if path.is_file() and not _OF_OTHERS.intersection(path.resolve().parents)
    ]
    return f" ({own[-1][0].name}:{own[-1][1]})" if own else ""


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
