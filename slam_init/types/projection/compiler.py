"""The decorators of the compiled projection."""

from __future__ import annotations

from pathlib import Path

from quest.jit import compiler_of

#: The folder of the projection, for compilers of loops that call it.
FOLDER = Path(__file__).parent
compiled = compiler_of(FOLDER)
#: For what only other loops call.
part = compiler_of(FOLDER, part=True)
