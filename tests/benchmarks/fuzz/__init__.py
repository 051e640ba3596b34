"""Mutated files for each reader: ``python -m tests.benchmarks.fuzz``."""
