"""The decorator of the compiled loops of the joint fit."""

from __future__ import annotations

from pathlib import Path

from quest.jit import compiler_of

compiled = compiler_of(Path(__file__).parent)
