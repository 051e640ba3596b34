"""Attacks on the readers."""

from __future__ import annotations

from slam_init.benchmarks.attacks.attack import Attack

__all__ = ["ATTACKS"]

#: In the order of the table.
ATTACKS: tuple[Attack, ...] = ()
