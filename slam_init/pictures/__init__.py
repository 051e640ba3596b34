"""Pictures of a run: ``overview.png``.

:mod:`slam_init.pictures.story` keeps the few frames that are shown, and :mod:`slam_init.pictures.overview` draws them
with the result. The same run gives the same bytes with the same version of matplotlib.
"""
