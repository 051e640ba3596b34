"""Folders of posed images, as the data sets of this field are published.

Each module has a table ``LAYOUTS``. A layout finds its files, and lists the images with what the files state of each;
:func:`slam_init.datasets.posed_images.image_sequence` makes the source.
"""

from slam_init.datasets.layouts import driving, listed, photographs

__all__ = ["LAYOUTS"]

#: All layouts. They are tried in this order, which is that of ``docs/how-to/data-sets.md``.
LAYOUTS = (*listed.LAYOUTS, *driving.LAYOUTS, *photographs.LAYOUTS)
