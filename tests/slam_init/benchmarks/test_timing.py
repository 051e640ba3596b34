"""Times per frame and stage, and the description of the machine."""

from __future__ import annotations

import platform

from slam_init.benchmarks.timing import machine, measure, timing_tables


def test_all_frames_of_a_static_world_are_waiting_frames():
    source = "synth:static?frames=3&width=320&height=240"
    measured = measure("static", [(source, 0), (source, 1)])
    assert (len(measured.waiting_ms), len(measured.accepted_ms)) == (6, 0)
    assert measured.stages_ms["track"]["calls"] == 6
    tables = timing_tables([measured])
    assert "static" in tables
    assert "(6)" in tables


def test_the_description_of_the_machine_does_not_contain_its_name():
    assert platform.python_version() in machine()
    assert not platform.node() or platform.node() not in machine()
