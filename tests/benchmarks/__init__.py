"""Programs that measure the project; run as ``python -m tests.benchmarks.NAME`` from a checkout."""
