"""Attacks of a hostile user, with what has to happen and what does: ``python -m tests.benchmarks.attacks``."""
