"""Live sources and the live viewer on the command line."""

import os
import signal

import numpy as np
import pytest
from cli_files import IMAGES, WITH

import slam_init.initializer
import slam_init.recording.viewer
from slam_init.cli import main
from slam_init.system.process_io import first_interrupt_calls


@pytest.fixture
def stdin():
    """The standard input holds three grey images of 64x48 pixels as Y4M."""
    frames = b"".join(b"FRAME\n" + np.full(64 * 48, 50 * k, np.uint8).tobytes() for k in range(3))
    read, write = os.pipe()
    os.write(write, b"YUV4MPEG2 W64 H48 F30:1 Cmono\n" + frames)
    os.close(write)
    before = os.dup(0)
    os.dup2(read, 0)
    yield
    os.dup2(before, 0)
    os.close(before)
    os.close(read)


def test_a_live_source_and_a_stored_one_have_the_same_options(world, pipeline, stdin, monkeypatch):
    monkeypatch.setattr(slam_init.initializer, "load_all", lambda: None)  # of no use for a stand-in
    for source in ("-", IMAGES):
        assert main(["run", source, *WITH]) == 0
    (live, _, config, _), (_, _, stored, _) = pipeline.calls
    assert (live.kind, live.name) == ("live", "standard input")
    assert config == stored


@pytest.mark.parametrize("command", [["info", "camera:0"], ["compare", "rtsp://me:secret@host/a"]])
def test_other_commands_refuse_live_sources_in_one_line(command, capsys):
    assert main(command) == 2
    error = capsys.readouterr().err
    assert "it can only be run" in error and "secret" not in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([IMAGES, "--live"], "spawn"),
        (["--live=rerun+http://host:1/proxy", IMAGES], "rerun+http://host:1/proxy"),
        ([IMAGES], None),
    ],
)
def test_the_viewer_is_started_or_named(world, pipeline, monkeypatch, words, text):
    monkeypatch.setattr(slam_init.recording.viewer, "viewer_url", lambda asked: f"url of {asked}")
    assert main(["run", *words, *WITH]) == 0
    ((source, _, _, options),) = pipeline.calls
    assert source.kind == "images"
    assert options["viewer"] == (None if text is None else f"url of {text}")


def test_a_viewer_that_is_not_there_ends_the_run_before_it_begins(world, pipeline, capsys):
    assert main(["run", IMAGES, *WITH, "--live=rerun+http://127.0.0.1:1/proxy"]) == 2
    assert "no viewer answers there" in capsys.readouterr().err
    assert pipeline.calls == []


def test_the_first_interrupt_is_reported_and_the_second_interrupts():
    message = []
    # A program in the background of a shell ignores interrupts, and so would this test.
    at_first = signal.signal(signal.SIGINT, signal.default_int_handler)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), first_interrupt_calls(lambda: message.append("stop")):
        signal.raise_signal(signal.SIGINT)
        assert message == ["stop"]
        signal.raise_signal(signal.SIGINT)
    assert message == ["stop"]
    assert signal.getsignal(signal.SIGINT) == before
    signal.signal(signal.SIGINT, at_first)
