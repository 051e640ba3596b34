"""The decorator of the compiled loops of the joint fit."""

from __future__ import annotations

from pathlib import Path

from quest.jit import compiler_of
from slam_init.lenses.compiler import FOLDER as LENSES

#: Sums may be reordered: so a processor makes several lanes of a sum at once.
compiled = compiler_of(Path(__file__).parent, LENSES, reorders_sums=True)
#: For what only other loops call.
part = compiler_of(Path(__file__).parent, LENSES, reorders_sums=True, part=True)
