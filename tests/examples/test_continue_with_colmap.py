"""COLMAP continues from the map: on a real sequence it registers all images, from our poses and in our world."""

import continue_with_colmap as example
import pytest
from continue_with_colmap import continue_with_colmap, main
from paths import DATA

pytestmark = pytest.mark.process

SEQUENCE = DATA / "middlebury" / "templeRing_19"


def test_a_wrong_argument_is_one_line(capsys):
    assert main(["synth:room", "many"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.skipif(not SEQUENCE.is_dir(), reason=f"needs {SEQUENCE}")
def test_colmap_registers_the_images_of_a_real_sequence_from_our_poses(capsys, monkeypatch):
    pytest.importorskip("pycolmap")
    found = []

    def kept(*arguments):
        found.append(continue_with_colmap(*arguments))
        return found[0]

    monkeypatch.setattr(example, "_FEATURES", 1500)
    monkeypatch.setattr(example, "_KNOWN", 8)
    monkeypatch.setattr(example, "continue_with_colmap", kept)
    assert main([str(SEQUENCE), "7"]) == 0
    (registered,) = found
    assert len(registered.world_from_cam) == registered.images >= 5
    assert f"{registered.images} of {registered.images} images" in capsys.readouterr().out
