"""Pictures of a run: ``overview.png``, drawn with matplotlib on its bundled fonts, without a display.

:mod:`slam_init.pictures.story` keeps the few frames that are shown, :mod:`slam_init.pictures.panels` and
:mod:`slam_init.pictures.map_panels` draw the parts, and :mod:`slam_init.pictures.overview` puts them together. All
figures come from the result and its summary. The same run gives the same bytes with the same version of matplotlib.
"""
