"""Programs that regenerate the figures of the README: ``python -m slam_init.benchmarks.initialization`` and ``timing``.

This module loads nothing, so that the programs can settle the number of threads before numpy is loaded.
"""
