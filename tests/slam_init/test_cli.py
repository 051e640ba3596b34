"""The contract of the command line: exit codes, one line on stderr, nothing half-written."""

import json
import os
import re
import signal
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from written import contents

import slam_init.runner
from slam_init.cli import main
from slam_init.errors import SourceError
from slam_init.output.summary import (
    SCHEMA,
    AttemptRecord,
    CameraRecord,
    FocalLengthRecord,
    HypothesisRecord,
    KeyframeRecord,
    SourceRecord,
    Summary,
)
from slam_init.types.comparison import Margin
from slam_init.types.reasons import Verdict
from slam_init.types.result import Attempt, GroundTruthErrors

CAMERA = "model: pinhole\nwidth: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31.5\ncy: 23.5\n"


def attempts(*verdicts):
    return tuple(AttemptRecord.of(Attempt((0, k + 1), Verdict(verdict))) for k, verdict in enumerate(verdicts))


INITIALIZED = Summary(
    schema=SCHEMA,
    status="initialized",
    reason=None,
    advice="",
    source=SourceRecord("images", "images"),
    method="quest",
    seed=0,
    camera=CameraRecord("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5, (), False),
    frames_read=23,
    frames_to_init=23,
    keyframes=(KeyframeRecord(0, 0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),),
    landmarks=431,
    median_parallax_deg=3.21,
    reprojection_rmse_px=0.314,
    scene="general",
    focal_length=None,
    hypotheses=(),
    margin=None,
    attempts=attempts("low_parallax", "accepted"),
    timing_ms={},
    ground_truth=GroundTruthErrors(0.12, 0.8, None, 1.0),
    continued=None,
    notes=(),
    provenance=None,
)
REFUSED = replace(
    INITIALIZED,
    status="not_initialized",
    reason=Verdict.STATIC_CAMERA,
    advice="the camera stands still: move it sideways",
    frames_to_init=None,
    keyframes=(),
    landmarks=0,
    attempts=attempts(*4 * ["static_camera"]),
    ground_truth=None,
)


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def pipeline(monkeypatch):
    """Stands in for the pipeline: records its arguments, gives what it is told to."""

    class Fake:
        def __init__(self):
            self.summary, self.raises, self.calls = INITIALIZED, None, []

        def run(self, source, camera, config, **options):
            self.calls.append((source, camera, config, options))
            if self.raises:
                raise self.raises
            return None, self.summary

    fake = Fake()
    monkeypatch.setattr(slam_init.runner, "run", fake.run, raising=False)
    return fake


@pytest.fixture
def images(tmp_path):
    folder = tmp_path / "my images é"
    folder.mkdir()
    for i in range(3):
        image = np.random.default_rng(i).integers(0, 255, (48, 64), dtype=np.uint8)
        (folder / f"{i}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return folder


@pytest.fixture
def world(tmp_path, images):
    """Files that can be wrong in every way, under short names."""
    files = {
        "good.yaml": CAMERA,
        "other_size.yaml": CAMERA.replace("64", "128"),
        "zero.yaml": CAMERA.replace("fx: 60", "fx: 0"),
        "negative.yaml": CAMERA.replace("fy: 60", "fy: -60"),
        "nan.yaml": CAMERA.replace("fx: 60", "fx: .nan"),
        "text.yaml": CAMERA.replace("fx: 60", "fx: wide"),
        "missing.yaml": CAMERA.replace("fx: 60\n", ""),
        "broken.yaml": "fx: [1, 2\nfy: }",
        "unsafe.yaml": "fx: !!python/object/apply:os.mkdir ['pwned']\n",
        "empty.yaml": "",
        "bad.toml": "= 3",
        "unknown.toml": "magic = 1\n",
        "file": "a file",
        "garbage.mp4": b"\0\1\2garbage" * 500,
        "empty.mp4": b"",
        "\udcff.mp4": b"",
        "cut/0.png": (images / "0.png").read_bytes()[:60],
        "full/something": "x",
        "empty/images/.keep": "",
        "line/rgb.txt": "not a line\n",
    }
    for name, content in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    for i, size in enumerate([(64, 48), (32, 24)]):
        (tmp_path / "sizes").mkdir(exist_ok=True)
        data = cv2.imencode(".png", np.zeros(size[::-1], np.uint8))[1].tobytes()
        (tmp_path / "sizes" / f"{i}.png").write_bytes(data)
    return tmp_path


IMAGES = "my images é"
WITH = ["--camera", "good.yaml"]
BAD = {
    # usage
    "no command": ([], "COMMAND"),
    "unknown command": (["frobnicate"], "frobnicate"),
    "unknown option": (["run", "--frob"], "--frob"),
    "abbreviated option": (["run", "--see", "3"], "--see"),
    "seed no number": (["run", "--seed", "x"], "--seed"),
    "seed negative": (["run", "--seed", "-1"], "--seed"),
    "start negative": (["run", "--start", "-1"], "--start"),
    "start beyond the end": (["run", IMAGES, *WITH, "--start", "3"], "start is 3"),
    "max-frames zero": (["run", "--max-frames", "0"], "--max-frames"),
    "continue negative": (["run", "--continue", "-5"], "--continue"),
    "method unknown": (["run", "--method", "magic"], "magic"),
    "two sources": (["run", "a", "b"], "b"),
    "info of nothing": (["info"], "SOURCE"),
    # source
    "missing source": (["run", "nowhere"], "nowhere"),
    "empty name": (["run", ""], "''|no sequence"),
    "empty folder": (["run", "empty"], "no sequence"),
    "text file": (["run", "file"], "video"),
    "garbage video": (["run", "garbage.mp4"], "garbage.mp4"),
    "video of no Unicode name": (["run", "\udcff.mp4"], "rename"),
    "empty video": (["run", "empty.mp4"], "empty.mp4"),
    "one image": (["run", f"{IMAGES}/0.png"], "folder"),
    "unreadable image": (["run", "cut", *WITH], "0.png"),
    "broken line": (["run", "line", *WITH], "rgb.txt:1"),
    "unknown scene": (["run", "synth:nowhere"], "rotate-then-move"),
    "unknown scene option": (["run", "synth:room?frob=1"], "frob"),
    "null byte": (["run", "a\0b"], "a"),
    # camera
    "no calibration": (["run", IMAGES], "--camera guess"),
    "missing camera file": (["run", IMAGES, "--camera", "nowhere.yaml"], "nowhere.yaml"),
    "camera is a folder": (["run", IMAGES, "--camera", "full"], "full"),
    "other size": (["run", IMAGES, "--camera", "other_size.yaml"], "128x48"),
    "focal zero": (["run", IMAGES, "--camera", "zero.yaml"], "zero.yaml: .*fx"),
    "focal negative": (["run", IMAGES, "--camera", "negative.yaml"], "negative.yaml: .*fy"),
    "focal nan": (["run", IMAGES, "--camera", "nan.yaml"], "nan.yaml: .*fx"),
    "focal text": (["run", IMAGES, "--camera", "text.yaml"], "text.yaml: .*fx"),
    "focal missing": (["run", IMAGES, "--camera", "missing.yaml"], "missing.yaml: .*fx"),
    "broken yaml": (["run", IMAGES, "--camera", "broken.yaml"], "broken.yaml"),
    "unsafe yaml": (["run", IMAGES, "--camera", "unsafe.yaml"], "unsafe.yaml"),
    "empty yaml": (["run", IMAGES, "--camera", "empty.yaml"], "empty"),
    "video as camera": (["run", IMAGES, "--camera", "garbage.mp4"], "garbage.mp4"),
    # config
    "missing config": (["run", "--config", "nowhere.toml"], "nowhere.toml"),
    "empty config": (["run", "--config", ""], "cannot be read"),
    "broken config": (["run", "--config", "bad.toml"], "bad.toml"),
    "unknown key": (["run", "--config", "unknown.toml"], "magic"),
    "readout text": (["run", IMAGES, *WITH, "--readout", "fast"], "--readout is 'fast'"),
    "readout negative": (["run", IMAGES, *WITH, "--readout=-5"], "readout"),
    "readout nan": (["run", IMAGES, *WITH, "--readout", "nan"], "readout"),
    "readout sideways": (["run", IMAGES, *WITH, "--readout", "5,sideways"], "readout direction"),
    # other commands
    "synth unknown scene": (["synth", "nowhere", "--out", "out"], "rotate-then-move"),
    "synth without out": (["synth", "room"], "--out"),
    "synth no frames": (["synth", "room", "--out", "out", "--frames", "0"], "--frames"),
    "synth too many frames": (["synth", "room", "--out", "out", "--frames", "99999999"], "frames"),
    "synth negative seed": (["synth", "room", "--out", "out", "--seed", "-1"], "--seed"),
    "info of nowhere": (["info", "nowhere"], "nowhere"),
    "info with a bad camera": (["info", IMAGES, "--camera", "zero.yaml"], "fx"),
}


def assert_refused(code, capture, word):
    out, err = capture.readouterr()
    assert code == 2
    assert out == ""
    assert err.startswith("slam-init: error: ")
    assert len(err.splitlines()) == 1 and err.endswith("\n")
    assert re.search(word, err), err


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_code_2_and_writes_nothing(world, pipeline, capfd, case):
    arguments, word = BAD[case]
    if arguments[:1] == ["run"]:
        arguments = [*arguments, "--out", "out"]
    assert_refused(main(arguments), capfd, word)
    assert not (world / "out").exists() and not (world / "pwned").exists()
    assert pipeline.calls == []


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["run", "--out", "file"], "file"),
        (["run", "--out", "file/below"], "file"),
        (["run", IMAGES, *WITH, "--out", IMAGES], "not empty"),
        (["run", IMAGES, *WITH, "--out", "."], "not empty"),
        (["compare", "points:room", "--out", "full"], "not empty"),
        (["run", "--out", "a\0b"], "out"),
        (["run", "--out", ""], "--out is empty"),
        (["run", "--out", "\udcff"], "out"),
        (["synth", "room", "--out", ""], "--out is empty"),
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


@pytest.mark.parametrize("error", [SourceError("frame 7: cut off"), SourceError("two\nlines")])
def test_an_error_met_on_the_way_is_one_line_too(world, pipeline, capfd, error):
    pipeline.raises = error
    assert_refused(main(["run", IMAGES, *WITH]), capfd, r"frame 7|two\\nlines")


def test_interruption_is_one_line_and_130(world, pipeline, capfd):
    pipeline.raises = KeyboardInterrupt()
    assert main(["run", IMAGES, *WITH]) == 130
    assert capfd.readouterr() == ("", "slam-init: interrupted\n")


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


def interrupting(monkeypatch, at_frame):
    """Interrupt a run when it reads a frame; -1: before the first one."""
    from slam_init.frontend.tracks import Tracker

    track = Tracker.track

    def interrupted(self, frame):
        if frame.index == at_frame or at_frame < 0:
            raise KeyboardInterrupt
        return track(self, frame)

    monkeypatch.setattr(Tracker, "track", interrupted)


def test_an_interrupt_before_the_first_frame_leaves_no_folder(world, monkeypatch, capfd):
    interrupting(monkeypatch, -1)
    assert main(["run", IMAGES, *WITH, "--out", "new/out"]) == 130
    assert not (world / "new").exists()


def test_an_interrupted_run_leaves_its_recording_beside_the_earlier_results(world, monkeypatch, capfd):
    command = ["run", IMAGES, *WITH, "--out", "out", "--quiet"]
    assert main(command) == 3
    before = contents(world / "out")
    with monkeypatch.context() as patch:
        interrupting(patch, 2)
        assert main(command) == 130
    assert capfd.readouterr().err == "slam-init: interrupted: out/interrupted.rrd shows the run so far\n"
    after = contents(world / "out")
    interrupted = after.pop("interrupted.rrd")
    assert after == before
    assert len(interrupted) > 1000
    assert main(command) == 3
    assert set(contents(world / "out")) == set(before)


def broken_later(world):
    folder = world / "broken later"
    folder.mkdir()
    for i in range(3):
        (folder / f"{i}.png").write_bytes((world / IMAGES / f"{i}.png").read_bytes()[: 60 if i == 2 else None])


def test_an_error_on_the_way_leaves_no_folder(world, capfd):
    broken_later(world)
    assert_refused(main(["run", "broken later", *WITH, "--out", "out"]), capfd, "2.png")
    assert not (world / "out").exists()


def test_an_error_on_the_way_leaves_the_results_of_an_earlier_run(world, capfd):
    broken_later(world)
    assert main(["run", IMAGES, *WITH, "--out", "out", "--quiet"]) == 3
    before = contents(world / "out", hidden=True)
    assert_refused(main(["run", "broken later", *WITH, "--out", "out"]), capfd, "2.png")
    after = contents(world / "out", hidden=True)
    assert {**after, ".slam-init/lock": b""} == {**before, ".slam-init/lock": b""}


@pytest.mark.parametrize("option", ["--config", "--camera"])
def test_a_file_that_the_run_reads_is_never_a_target(world, capfd, option):
    assert main(["run", IMAGES, *WITH, "--out", "out", "--quiet"]) == 3
    before = contents(world / "out")
    (world / "link.toml").symlink_to("out/config.toml")
    for given in ("out/config.toml", "link.toml"):
        arguments = ["run", IMAGES, *(WITH if option == "--config" else []), "--out", "out", option, given]
        assert_refused(main(arguments), capfd, "results would replace")
    assert contents(world / "out") == before


def test_what_decoders_print_is_silenced_but_not_pythons_stderr(world, pipeline, capfd, monkeypatch):
    def noisy(*_, **__):
        os.write(2, b"[mjpeg @ 0x1] overread 8\n")
        print("a warning for the user", file=sys.stderr)
        return None, INITIALIZED

    monkeypatch.setattr(slam_init.runner, "run", noisy, raising=False)
    assert main(["run", IMAGES, *WITH, "--quiet"]) == 0
    assert capfd.readouterr().err == "a warning for the user\n"
    os.write(2, b"restored\n")
    assert capfd.readouterr().err == "restored\n"


def test_arguments_reach_the_pipeline(world, pipeline, capsys):
    numbers = ["--start", "1", "--max-frames", "2", "--continue", "4", "--seed", "5"]
    assert main(["run", IMAGES, *WITH, *numbers, "--out", "results", "--quiet"]) == 0
    ((source, camera, config, options),) = pipeline.calls
    assert (source.kind, len(source), camera.fx, config.seed, config.method) == ("images", 3, 60, 5, "quest")
    assert options.pop("notes") == ()
    assert str(options.pop("out")) == "results"
    assert options == {"start": 1, "max_frames": 2, "continue_frames": 4, "progress": False}
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("text", "readout"),
    [("25", (25.0, "down")), ("25,up", (25.0, "up")), ("0", (0.0, "down")), ("auto", (None, "down"))],
)
def test_the_readout_of_the_command_line_reaches_the_pipeline(world, pipeline, text, readout):
    assert main(["run", IMAGES, *WITH, "--readout", text, "--quiet"]) == 0
    ((_, camera, _, _),) = pipeline.calls
    assert (camera.readout_ms, camera.readout_direction) == readout


def test_the_seed_makes_the_synthetic_world_too(pipeline, capsys):
    assert main(["run", "--seed", "7"]) == 0
    ((source, _, config, options),) = pipeline.calls
    assert (source.name, source.sequence.seed, config.seed) == ("room", 7, 7)
    assert str(options["out"]) == "slam-init-out"


def test_the_focal_length_is_adjusted_where_the_command_line_or_the_configuration_says_so(world, pipeline):
    Path("c.toml").write_text("[map]\nmin_resected = 30\n")
    Path("on.toml").write_text("[map]\nrefine_focal = true\n")
    for options in ([], ["--refine-focal"], ["--config", "c.toml", "--refine-focal"], ["--config", "on.toml"]):
        assert main(["run", IMAGES, *WITH, *options]) == 0
    maps = [config.map for _, _, config, _ in pipeline.calls]
    assert [map_.refine_focal for map_ in maps] == [False, True, True, True]
    assert maps[2].min_resected == 30


def test_a_removed_option_and_a_removed_method_end_in_one_line(world, pipeline, capsys):
    (world / "old.toml").write_text("[acceptance]\nmax_direction_error_deg = 10\n")
    assert main(["run", IMAGES, *WITH, "--config", "old.toml"]) == 2
    told = "old.toml: acceptance.max_direction_error_deg is gone: acceptance.max_risk decides (0.005 by default)\n"
    assert capsys.readouterr().err.endswith(told)
    assert main(["run", IMAGES, *WITH, "--method", "quest-window"]) == 2
    error = capsys.readouterr().err
    assert "unknown method 'quest-window'" in error
    assert error.count("\n") == 1
    assert pipeline.calls == []


def test_a_seed_of_the_configuration_counts_where_none_is_given(world, pipeline):
    (world / "c.toml").write_text("seed = 9\n")
    assert main(["run", IMAGES, *WITH, "--config", "c.toml"]) == 0
    assert pipeline.calls[0][2].seed == 9


def test_a_guess_is_asked_for_and_told(world, pipeline):
    assert main(["run", IMAGES, "--camera", "guess"]) == 0
    ((_, camera, _, options),) = pipeline.calls
    assert camera.guessed and camera.fx == 1.2 * 64
    assert "guess" in options["notes"][0]


def test_a_calibration_that_is_given_beats_that_of_the_source(world, pipeline):
    (world / IMAGES / "camera.yaml").write_text(CAMERA.replace("fx: 60", "fx: 99"))
    assert main(["run", IMAGES]) == 0
    assert main(["run", IMAGES, *WITH]) == 0
    assert [camera.fx for _, camera, _, _ in pipeline.calls] == [99, 60]


@pytest.mark.parametrize(("summary", "code"), [(INITIALIZED, 0), (REFUSED, 3)])
@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
def test_json_is_the_summary_and_nothing_else(world, pipeline, capfd, summary, code, quiet):
    pipeline.summary = summary
    assert main(["run", IMAGES, *WITH, "--json", *quiet]) == code
    out, err = capfd.readouterr()
    assert json.loads(out) == summary.as_dict() and err == ""


def test_names_that_no_stream_takes_are_told_all_the_same(world, capfd):
    (world / IMAGES).rename(world / "\udcff ü")
    for image in (world / "\udcff ü").iterdir():
        image.rename(image.with_name(f"\udcff{image.name}"))
    source = ["\udcff ü", *WITH]
    assert main(["run", *source, "--json", "--out", "out"]) == 3
    out, err = capfd.readouterr()
    assert err == ""
    assert out.isascii() and out == (world / "out" / "summary.json").read_text()
    assert json.loads(out)["source"]["name"] == "\udcff ü"
    assert main(["info", *source]) == 0
    assert "\\udcff ü (images)" in capfd.readouterr().out


def test_report_of_a_map(world, pipeline, capsys):
    assert main(["run", IMAGES, *WITH, "--out", "there"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("initialized after 23 frames\n")
    for fact in (
        "431",
        "3.21 deg",
        "0.31 px",
        "rotation 0.12 deg",
        "direction 0.8 deg",
        "there",
        "1 low parallax",
    ):
        assert fact in out
    assert "None" not in out and "ATE" not in out


def test_report_tells_an_adjusted_focal_length_with_its_uncertainty(world, pipeline, capsys):
    assert main(["run", IMAGES, *WITH]) == 0
    assert "focal length" not in capsys.readouterr().out
    pipeline.summary = replace(INITIALIZED, focal_length=FocalLengthRecord(57.0, 57.0, 0.95, 0.0123))
    assert main(["run", IMAGES, *WITH]) == 0
    assert "0.950 +- 0.012 times the stated one" in capsys.readouterr().out


def test_report_of_a_refusal_tells_reason_advice_and_attempts(world, pipeline, capsys):
    pipeline.summary = REFUSED
    assert main(["run", IMAGES, *WITH]) == 3
    out = capsys.readouterr().out
    assert out.startswith("not initialized: static camera\n")
    assert "move it sideways" in out and "4 static camera" in out


def test_report_of_an_undecided_run_tells_the_two_maps(world, pipeline, capsys):
    keyframes = tuple(KeyframeRecord(frame, 0.0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for frame in (3, 9))
    kept = HypothesisRecord(keyframes, 100, 0.3)
    pipeline.summary = replace(
        REFUSED, reason=Verdict.AMBIGUOUS_PLANE, hypotheses=(kept, kept), margin=Margin(9.0, 1.25)
    )
    assert main(["run", IMAGES, *WITH]) == 3
    assert "two maps of frames 3, 9; the tracks prefer the first by 9.0 nats" in capsys.readouterr().out


def test_synth_writes_what_info_and_run_read(tmp_path, pipeline, capsys):
    assert main(["synth", "wall", "--out", "s", "--frames", "3", "--seed", "4"]) == 0
    assert "3 frames" in capsys.readouterr().out
    assert main(["info", "s", "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info["kind"], info["frames"], info["width"], info["camera"]["model"]) == (
        "tum",
        3,
        640,
        "pinhole",
    )
    assert info["ground_truth"]["frames"] == 3 and info["ground_truth"]["path_length"] >= 0
    assert main(["info", "s"]) == 0
    assert "for 3 of 3 frames" in capsys.readouterr().out
    assert main(["run", "s"]) == 0


def test_info_of_bare_images_tells_what_is_missing(world, capsys):
    assert main(["info", IMAGES]) == 0
    out = capsys.readouterr().out
    assert "--camera guess" in out and "none" in out and "64x48, grey" in out


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["synth", "--help"], ["info", "--help"]])
def test_help(arguments, capsys):
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert out.startswith("usage: slam-init") and err == ""
