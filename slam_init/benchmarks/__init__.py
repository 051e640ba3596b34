"""Programs that measure the figures of the README, for example ``python -m slam_init.benchmarks.initialization``.

This module imports nothing, so that the programs can set the number of threads before numpy is imported.
"""
