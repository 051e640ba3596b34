"""Bad input, interrupts and errors: exit codes, one line on stderr, nothing half-written."""

import os
import re
import signal
import subprocess
import sys

import pytest
from cli_files import IMAGES, WITH
from written import contents

import slam_init.runner
from slam_init.cli import main
from slam_init.errors import SourceError

BAD = {
    # usage
    "no command": ([], "COMMAND"),
    "unknown command": (["frobnicate"], "frobnicate"),
    "unknown option": (["run", "--frob"], "--frob"),
    "seed of 5,000 digits": (["run", "--seed", f"1{5000 * '0'}"], "--seed"),
    "start negative": (["run", "--start", "-1"], "--start"),
    "start beyond the end": (["run", IMAGES, *WITH, "--start", "3"], "start is 3"),
    "refine without a window": (["run", "--refine", "5", "--method", "orb-slam3"], "use --continue"),
    "scale of no kind": (["run", "--scale", "stick:1"], "marker:tag36h11"),
    "scale without a length": (["run", "--scale", "height:tall"], "metres"),
    "scale by a board of one corner": (["run", "--scale", "board:1x6:0.03"], "inner corners"),
    "method unknown": (["run", "--method", "magic"], "magic"),
    "two sources": (["run", "a", "b"], "b"),
    "info of nothing": (["info"], "SOURCE"),
    # source
    "missing source": (["run", "nowhere"], "nowhere"),
    "empty name": (["run", ""], "source is empty"),
    "text file": (["run", "file"], "video"),
    "garbage video": (["run", "garbage.mp4"], "garbage.mp4"),
    "unreadable image": (["run", "cut", *WITH], "0.png"),
    # frames and masks
    "every zero": (["run", IMAGES, *WITH, "--every", "0"], "every 0 frames"),
    "fps zero": (["run", IMAGES, *WITH, "--fps", "0"], "frames a second"),
    "every and fps": (["run", IMAGES, *WITH, "--every", "2", "--fps", "3"], "one of both"),
    "missing mask": (["run", IMAGES, *WITH, "--mask", "nowhere.png"], "nowhere.png"),
    "text as mask": (["run", IMAGES, *WITH, "--mask", "file"], "file: not a readable image"),
    "mask of another size": (["run", IMAGES, *WITH, "--mask", "sizes/1.png"], "mask is 32x24, .* 64x48"),
    "no mask of a frame": (["run", IMAGES, *WITH, "--mask", "full"], "no mask for the frame 0.png"),
    "compare with a missing mask": (["compare", "synth:room", "--mask", "nowhere.png", "--out", "out"], "nowhere.png"),
    "compare within no time": (["compare", "points:room", "--time-limit", "nan", "--out", "out"], "--time-limit"),
    "source behind a bare option": (["run", "--live", IMAGES], "give the address of a viewer"),
    "a result as a source": (["run", "result"], "a result of slam-init: use slam-init view result, or info"),
    "a result to compare on": (["compare", "result", "--out", "out"], "a result of slam-init"),
    "compare every zero": (["compare", "points:room", "--use-every", "0", "--out", "out"], "--use-every"),
    # camera
    "no focal length": (["run", IMAGES, "--camera", "f=none"], "f=1250"),
    "missing camera file": (["run", IMAGES, "--camera", "nowhere.yaml"], "nowhere.yaml"),
    "camera is a folder": (["run", IMAGES, "--camera", "full"], "full"),
    "other size": (["run", IMAGES, "--camera", "other_size.yaml"], "128x48"),
    "empty camera": (["run", IMAGES, "--camera", ""], "camera is empty"),
    # options that would have no effect
    "matcher for a program": (["run", "--matcher", "sift", "--method", "command:true {images} {out}"], "--matcher"),
    "refine for a program": (["run", "--refine", "5", "--method", "command:true {images} {out}"], "--refine"),
    "drops of files": (["run", IMAGES, *WITH, "--no-drop"], "live sources"),
    # config
    "missing config": (["run", "--config", "nowhere.toml"], "nowhere.toml"),
    "empty config": (["run", "--config", ""], "config is empty"),
    "readout text": (["run", IMAGES, *WITH, "--readout", "fast"], "--readout is 'fast'"),
    # other commands
    "synth no frames": (["synth", "room", "--out", "out", "--frames", "0"], "--frames"),
    "synth too many frames": (["synth", "room", "--out", "out", "--frames", "99999999"], "frames"),
    "info with a bad camera": (["info", IMAGES, "--camera", "zero.yaml"], "fx"),
}


def assert_refused(code, capture, word):
    out, err = capture.readouterr()
    assert code == 2
    assert out == ""
    assert err.startswith("slam-init: error: ")
    assert len(err.splitlines()) == 1 and err.endswith("\n")
    assert re.search(word, err), err


def test_bad_input_is_one_line_and_exit_code_2_and_writes_nothing(world, pipeline, capfd):
    for case, (arguments, word) in BAD.items():
        if arguments[:1] == ["run"]:
            arguments = [*arguments, "--out", "out"]
        assert_refused(main(arguments), capfd, word)
        assert not (world / "out").exists(), case
    assert pipeline.calls == []


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["run", IMAGES, *WITH, "--out", IMAGES], "not empty"),
        (["run", IMAGES, *WITH, "--out", "."], "not empty"),
        (["compare", "points:room", "--out", "full"], "not empty"),
        (["run", "--out", "a\0b"], "out"),
        (["run", "--out", ""], "out is empty"),
        (["run", "--out", "\udcff"], "out"),
        (["synth", "room", "--out", ""], "out is empty"),
        (["synth", "room", "--out", "file"], "file"),
        (["synth", "room", "--out", "full"], "not empty"),
    ],
)
def test_places_that_cannot_be_written(world, pipeline, capfd, arguments, word):
    before = sorted(str(path) for path in world.rglob("*"))
    assert_refused(main(arguments), capfd, word)
    assert sorted(str(path) for path in world.rglob("*")) == before
    assert pipeline.calls == []


def test_a_folder_without_permission_is_refused(world, pipeline, capfd, monkeypatch):
    # The superuser may write everywhere: what the system would answer others is put in its mouth.
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert_refused(main(["run", IMAGES, *WITH, "--out", "new/below"]), capfd, "permission")
    assert not (world / "new").exists()
    assert pipeline.calls == []


@pytest.mark.parametrize(
    ("error", "word"),
    [
        (SourceError("frame 7: cut off"), "frame 7"),
        (SourceError("two\nlines"), r"two\\nlines"),
        (MemoryError(), ""),
        (ImportError("libnothing.so: cannot open shared object file"), "libnothing"),
    ],
)
def test_an_error_met_on_the_way_is_one_line_too(world, pipeline, capfd, error, word):
    pipeline.raises = error
    assert_refused(main(["run", IMAGES, *WITH]), capfd, word)


def test_an_interrupt_that_an_extension_turns_into_its_own_error_is_130_too(world, monkeypatch, capfd):
    def import_an_extension(*_, **__):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None

    monkeypatch.setattr(slam_init.runner, "run", import_an_extension, raising=False)
    # A job in the background ignores the signal, and so would the test.
    outside = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(["run", IMAGES, *WITH]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, outside)
    assert capfd.readouterr() == ("", "slam-init: interrupted\n")


def test_a_signal_that_ends_programs_gives_128_and_its_number(world, monkeypatch, capfd):
    for name, code in (("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)):
        number = getattr(signal, name)
        monkeypatch.setattr(slam_init.runner, "run", lambda *_, number=number, **__: signal.raise_signal(number))
        outside = signal.signal(number, signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL)
        try:
            assert main(["run", IMAGES, *WITH]) == code
        finally:
            signal.signal(number, outside)
        assert capfd.readouterr() == ("", "slam-init: interrupted\n")


def test_an_interrupted_run_leaves_its_recording_beside_the_earlier_results(world, monkeypatch, capfd):
    from slam_init.frontend.tracks import Tracker

    track = Tracker.track

    def interrupted(self, frame, **options):
        if frame.index == 2:
            raise KeyboardInterrupt
        return track(self, frame, **options)

    command = ["run", IMAGES, *WITH, "--out", "out", "--quiet"]
    assert main(command) == 3
    before = contents(world / "out")
    with monkeypatch.context() as patch:
        patch.setattr(Tracker, "track", interrupted)
        assert main(command) == 130
    assert capfd.readouterr().err == "slam-init: interrupted: out/interrupted.rrd shows the run so far\n"
    after = contents(world / "out")
    interrupted = after.pop("interrupted.rrd")
    assert after == before
    assert len(interrupted) > 1000
    assert main(command) == 3
    assert set(contents(world / "out")) == set(before)


@pytest.mark.parametrize("option", ["--config", "--camera"])
def test_a_file_that_the_run_reads_is_never_a_target(world, capfd, option):
    assert main(["run", IMAGES, *WITH, "--out", "out", "--quiet"]) == 3
    before = contents(world / "out")
    (world / "link.toml").symlink_to("out/config.toml")
    for given in ("out/config.toml", "link.toml"):
        arguments = ["run", IMAGES, *(WITH if option == "--config" else []), "--out", "out", option, given]
        assert_refused(main(arguments), capfd, "results would replace")
    assert contents(world / "out") == before


def test_what_decoders_print_is_silenced_but_not_pythons_stderr():
    code = (
        "import os, sys; from slam_init.system.process_io import silence_native_stderr; silence_native_stderr();"
        "os.write(2, b'[mjpeg @ 0x1] overread 8'); print('a warning for the user', file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "a warning for the user\n"


@pytest.mark.parametrize("threads", ["0", "x"])
def test_a_wrong_variable_of_numba_is_one_line(threads, tmp_path):
    code = "from slam_init.cli import entry_point; entry_point()"
    words = [sys.executable, "-c", code, "run", "synth:static?frames=2&width=96&height=64"]
    done = subprocess.run(
        words, env=os.environ | {"NUMBA_NUM_THREADS": threads}, cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1) and "NUMBA_" in done.stderr


def test_out_may_have_any_name_that_a_folder_can_have(world, capsys):
    for name in ("a\nb", " \u202e\u05d0\u05d1 ", "-out", "a%b?c#d"):
        assert main(["calibrate", IMAGES, f"--out={name}"]) == 3
        assert (world / name / "calibration.json").is_file() and not capsys.readouterr().err


def test_out_that_can_be_no_folder_is_one_line(world, pipeline, capsys):
    (world / "file").write_text("mine")
    os.mkfifo(world / "pipe")
    for name in (300 * "a", "/dev/null", "file/out", "pipe"):
        assert main(["run", IMAGES, *WITH, "--out", name]) == 2
        error = capsys.readouterr().err
        assert error.startswith("slam-init: error: --out") and error.count("\n") == 1
    assert pipeline.calls == [] and (world / "file").read_text() == "mine"


def test_a_jpeg_of_fill_bytes_is_refused_quickly(world, capsys):
    (world / IMAGES / "0.png").rename(world / "kept.png")
    (world / IMAGES / "0.jpg").write_bytes(b"\xff\xd8" + b"\xff" * 30_000_000)
    assert main(["run", IMAGES, *WITH]) == 2
    assert "0.jpg: not a readable image" in capsys.readouterr().err
