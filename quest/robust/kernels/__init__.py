"""The compiled inner loops of robust estimation.

A sample needs some hundred operations on three numbers each. On arrays of that size numpy is 20 to 100 times slower
than these loops. Each loop has a readable counterpart in numpy, in the tests, which compare the two.

numba compiles a loop at its first call; :mod:`quest.machine_code` keeps the result. The modules are loaded, and numba
with them, when a loop is first used. The loops use neither fast-math nor threads: the same input gives the same bytes.

Poses are ``R, t = cam2_from_cam1`` with |t| = 1, bearings have unit norm, and ``u R m + t = v n``.
"""

# ruff: noqa: F403
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from quest.algebra import *
    from quest.robust.kernels.local_optimization import *
    from quest.robust.kernels.noise import *
    from quest.robust.kernels.parallax import *
    from quest.robust.kernels.planes import *
    from quest.robust.kernels.quest_five import *
    from quest.robust.kernels.refinement import *
    from quest.robust.kernels.rotations import *
    from quest.robust.kernels.samples import *
    from quest.robust.kernels.scoring import *

_FILES = "local_optimization noise parallax planes quest_five refinement rotations samples scoring"
_MODULES = ("quest.algebra", *(f"{__name__}.{file}" for file in _FILES.split()))


def __getattr__(name: str) -> object:
    for module in _MODULES:
        loaded = vars(import_module(module))
        if name in loaded:
            globals()[name] = loaded[name]  # so that the next call finds it at once
            return loaded[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
