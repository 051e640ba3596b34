"""COLMAP's incremental mapper as an external method (``pip install pycolmap``).

A command that runs it::

    slam-init compare FOLDER --method \
      'mapper=command:python docs/examples/external_pycolmap.py {images} {times} {camera} {out}'

The mapper is offline: it reads all frames before it chooses its first pair. So the script writes no
``frames_read.txt``, and its wait is that of all frames. SIFT of 20 frames takes ten seconds on one core, so the mapper
gets 20 frames, evenly spread. It has the options of its makers, with a fixed calibration and a fixed seed.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from slam_init.calibration.files import load_camera
from slam_init.output.colmap import colmap_camera, colmap_note

_MOST_FRAMES = 20


def main(arguments: list[str]) -> int:
    """Reconstruct a folder of frames.

    * ``arguments``: Folder of the frames, file of the time stamps, calibration, folder of the results.
    """
    import pycolmap

    images, times, calibration, out = map(Path, arguments)
    lines = [line.split() for line in times.read_text().splitlines()]
    stamps = {name: stamp for stamp, name in lines}
    count = min(len(lines), _MOST_FRAMES)
    names = sorted({lines[round(i * (len(lines) - 1) / (count - 1))][1] for i in range(count)})
    reader = pycolmap.ImageReaderOptions()
    camera = load_camera(calibration)
    if note := colmap_note(camera):
        sys.exit(note)
    reader.camera_model, parameters = colmap_camera(camera)
    reader.camera_params = ",".join(repr(float(value)) for value in parameters)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_extra_params = options.ba_refine_principal_point = False
    options.multiple_models = False
    options.min_model_size = 2  # a first map of two frames is a map
    options.random_seed = 0
    with tempfile.TemporaryDirectory() as work:
        database = Path(work) / "database.db"
        pycolmap.extract_features(
            database, images, names, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
            device=pycolmap.Device.cpu,
        )  # fmt: skip
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
        models = pycolmap.incremental_mapping(database, images, work, options)
        if not models:
            return 0
        largest = max(models.values(), key=lambda model: model.num_reg_images())
        rows = []
        for image in largest.images.values():
            world_from_cam = image.cam_from_world().inverse()
            numbers = [*world_from_cam.translation, *world_from_cam.rotation.quat]  # xyzw
            rows.append(f"{stamps[image.name]} {' '.join(f'{value:.12g}' for value in numbers)}")
    (out / "trajectory.txt").write_text("\n".join(sorted(rows, key=lambda row: float(row.split()[0]))) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
