"""The decorators of the compiled loops of lenses."""

from __future__ import annotations

from pathlib import Path

from quest.jit import compiler_of

#: The folder, for the compilers of loops that call these.
FOLDER = Path(__file__).parent
compiled = compiler_of(FOLDER)
#: For what only other loops call.
part = compiler_of(FOLDER, part=True)
