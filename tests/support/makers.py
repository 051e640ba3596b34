"""The programs of ``docs/make``, which make pages and pictures."""

import importlib.util
import sys

from paths import ROOT

MAKE = ROOT / "docs" / "make"
if str(MAKE) not in sys.path:  # the programs import one another
    sys.path.append(str(MAKE))


def maker(name: str):
    """A module of docs/make."""
    spec = importlib.util.spec_from_file_location(name, MAKE / f"{name}.py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
