"""Synthetic sequences with exact ground truth: rendered images of textured worlds, or tracks without images.

A sequence is a world of textured planes, a smooth camera path and a sensor, all by one seed. Poses are
``world_from_cam`` in metres; camera frames are optical (x right, y down, z forward); pixel centres lie at integers ::

    sequence = make_sequence("room", seed=3)
    image, depth = sequence.render(12)

Scenes: ``room`` (general), ``wall`` (one tilted plane), ``nadir`` (straight flight over flat ground), ``nadir-turn``
(flight in a turn over flat ground), ``corridor`` (forward motion), ``desk`` (dominant plane with objects), ``rotation``
(rotation-only camera), ``rotate-then-move`` and ``static``; these are the :data:`STANDARD_SCENES`. The scenes
``tilted-15``, ``tilted-30`` and ``tilted-45`` are level straight flights over flat ground. Their camera is tilted
forward or sideways by 15, 30 or 45 degrees from straight down. In ``handheld`` and ``handheld-wall`` (one wall) a hand
turns the camera about an axis that changes, with little or no translation; in ``pan`` the camera turns steadily.
:func:`make_points` makes tracks without images, in scenes of the same kind.

The option ``lens`` renders through a wide lens (:mod:`sequences_synth.camera`).

A frame may have a rolling shutter: a pixel in row y is exposed at ``t_frame + readout (y / height - 1/2)``, and the
pose and the time stamp of a frame are those of its middle row (:mod:`sequences_synth.camera`).
"""

from sequences_synth.options import PointOptions, SynthOptions
from sequences_synth.points import POINT_SCENES, PointSequence, make_points
from sequences_synth.scenes import SCENES, STANDARD_SCENES
from sequences_synth.sequence import SynthSequence, make_sequence
from sequences_synth.writer import write_tum

__all__ = [
    "POINT_SCENES",
    "SCENES",
    "STANDARD_SCENES",
    "PointOptions",
    "PointSequence",
    "SynthOptions",
    "SynthSequence",
    "make_points",
    "make_sequence",
    "write_tum",
]
