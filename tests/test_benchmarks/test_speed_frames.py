"""Times of frames and stages, and the description of the machine."""

from __future__ import annotations

import platform

from slam_init.datasets import open_source
from tests.benchmarks.speed import frames_table, machine, measure, stages_table


def test_all_frames_of_a_static_world_are_waiting_frames():
    measured = measure("static", open_source("synth:static?frames=3&width=320&height=240"))
    assert (len(measured.waiting_ms), measured.handover_ms, measured.frames) == (3, None, None)
    assert measured.stages_ms["track"]["calls"] == 3
    assert "static" in frames_table([measured], 2.0)
    assert "(3)" in stages_table([measured])


def test_the_description_of_the_machine_does_not_contain_its_name():
    assert platform.python_version() in machine()
    assert not platform.node() or platform.node() not in machine()
