"""Mutated files for each reader: ``python -m slam_init.benchmarks.fuzz``."""
