"""Attacks of a hostile user, with what has to happen and what does: ``python -m slam_init.benchmarks.attacks``."""
