"""Draws the figures of the pages of ``docs/explanation``: ``python docs/make/figures.py``.

* ``quest-eigenproblem.svg``: the normals of the epipolar planes, and what the eigenproblem of five matches gives.
* ``planar-ambiguity.svg``: the two motions of a plane, and the residuals of both in two views and in a third one.
* ``risk.svg``: the terms of the risk by frame, of a camera that turns before it moves, and of one over flat ground.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import quest
from quest.geometry.homography import decompose_homography
from quest.geometry.quaternion import matrix_from_quaternion, rotation_angle, rotation_from_vector, vector_from_rotation

Floats = NDArray[np.float64]

IMAGES = Path(__file__).resolve().parents[1] / "images"
BLUE, ORANGE, GREEN, GREY, RED = "#1f5fa8", "#d9730d", "#2e8b57", "#8a8f98", "#b3261e"


def main() -> None:
    """Draw all figures."""
    import matplotlib as mpl

    mpl.use("svg")
    # Same figure, same bytes: no date, and the ids of the paths from a fixed salt.
    mpl.rcParams |= {
        "svg.hashsalt": "slam-init",
        "svg.fonttype": "path",
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "figure.constrained_layout.use": True,
    }
    _save(_eigenproblem(), "quest-eigenproblem")
    _save(_planar_ambiguity(), "planar-ambiguity")
    _save(_risk(), "risk")


def _save(figure: Any, name: str) -> None:
    figure.savefig(IMAGES / f"{name}.svg", metadata={"Date": None})


def _views(rng: np.random.Generator, count: int, noise_px: float) -> tuple[Floats, Floats, Floats]:
    """Rays of points in two views with noise in pixels of a camera of 500 px, and the true R."""
    points = rng.uniform((-2, -1.5, 3), (2, 1.5, 7), (count, 3))
    R, t = rotation_from_vector(np.radians([3.0, 10.0, -4.0])), np.array([-0.8, 0.1, 0.25])
    rays = [points, points @ R.T + t]
    noisy = [ray / ray[:, 2:] + np.c_[rng.normal(0, noise_px / 500, (count, 2)), np.zeros(count)] for ray in rays]
    return noisy[0], noisy[1], R


def _eigenproblem() -> Any:
    """The equation, the normals of the epipolar planes at two rotations, and the candidates of five matches."""
    import matplotlib.pyplot as plt

    rng = np.random.default_rng(4)
    m, n, R = _views(rng, 60, 0.3)
    figure, (sketch, plane, axes) = plt.subplots(1, 3, figsize=(9, 3.1), width_ratios=(0.8, 1, 1))
    _draw_triangle(sketch)
    wrong = rotation_from_vector(np.radians([3.0, -4.0, 2.0])) @ R
    for rotation, color, label in ((R, BLUE, "true rotation"), (wrong, ORANGE, "rotation off by 5 deg")):
        normals = _unit(np.cross(m @ rotation.T, n))
        # The common translation is the direction that is least along all normals.
        first, second, along = np.linalg.svd(normals)[2]
        # A normal and its opposite are one direction.
        azimuth = (np.degrees(np.arctan2(normals @ second, normals @ first)) + 90) % 180 - 90
        plane.scatter(azimuth, np.degrees(np.arcsin(normals @ along)), s=9, color=color, label=label)
    plane.set(xlabel="direction of the normal within the plane (deg)", ylabel="angle out of the plane (deg)")
    plane.set_title("60 normals R m × n and their common plane", fontsize=8.5)
    plane.set_ylim(-25, 25)
    plane.legend(fontsize=7.5, frameon=False, loc="upper center")
    candidates = quest.quest5(m[:5], n[:5])
    angles = [np.degrees(rotation_angle(matrix_from_quaternion(q).T @ R)) for q in candidates]
    sampson = [_median_residual_px(matrix_from_quaternion(q), m, n) for q in candidates]
    best = int(np.argmin(sampson))
    axes.scatter(angles, sampson, s=26, color=GREY, label=f"the {len(candidates)} candidates of 5 matches")
    axes.scatter(angles[best], sampson[best], s=60, color=GREEN, label="chosen by the other 55 matches")
    axes.set(xscale="symlog", yscale="log", xlabel="rotation error (deg)", ylabel="median residual of 60 matches (px)")
    axes.set_title("the eigenvectors, evaluated by further matches", fontsize=8.5)
    axes.legend(fontsize=7.5, frameon=False, loc="upper left")
    axes.set_ylim(top=3000)
    return figure


def _draw_triangle(axes: Any) -> None:
    """The triangle of two cameras and a point."""
    centre2, point = np.array([1.0, 0.0]), np.array([0.75, 1.25])
    for start, end, color, text, at in (
        ((0.0, 0.0), point, BLUE, "u R m", (0.24, 0.68)),
        (centre2, point, BLUE, "v n", (0.93, 0.66)),
        (centre2, (0.0, 0.0), RED, "t", (0.5, -0.13)),
    ):
        axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "->", "color": color, "lw": 1.4})
        axes.text(*at, text, color=color, ha="center")
    axes.plot(*point, "o", color="black", ms=4)
    axes.text(-0.02, -0.13, "camera 1", ha="center", fontsize=8)
    axes.text(1.02, -0.13, "camera 2", ha="center", fontsize=8)
    axes.set(xlim=(-0.3, 1.3), ylim=(-0.25, 1.4), xticks=[], yticks=[], aspect="equal")
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_title("u R m + t = v n: one plane,\nso t is orthogonal to R m × n", fontsize=8.5)


def _median_residual_px(R: Floats, m: Floats, n: Floats) -> float:
    """Distance of the matches from the epipolar planes of a rotation and its best translation."""
    normals = np.cross(m @ R.T, n)
    t = np.linalg.svd(normals)[2][2]
    lines = np.cross(t, m @ R.T)
    return float(np.median(np.abs(np.einsum("ij,ij->i", n, lines)) / np.linalg.norm(lines[:, :2], axis=1)) * 500)


def _planar_ambiguity() -> Any:
    """The two motions of a homography in the plane that holds the normal and the translation, and their residuals."""
    import matplotlib.pyplot as plt

    rng = np.random.default_rng(1)
    normal, distance = np.array([np.sin(0.35), 0.0, np.cos(0.35)]), 3.0
    xy = rng.uniform(-1.6, 1.6, (80, 2))
    points = np.c_[xy, (distance - normal[0] * xy[:, 0]) / normal[2]]
    second = _pose(-4.0, (0.6, 0.0, 0.9))
    third = _pose(6.0, (-0.7, 0.0, 0.4))
    motions = decompose_homography(second[0] + np.outer(second[1], normal / distance), _unit(points))
    figure, axes = plt.subplots(1, 3, figsize=(9, 3.2), width_ratios=(1, 1, 0.8))
    residuals = []
    for place, (R, t, k) in enumerate(_sorted(motions, second)):
        depth = 1 / (_unit(points) @ k)
        scene = _unit(points) * depth[:, None]
        scale = np.median(depth) / np.median(np.linalg.norm(points, axis=1))
        scene, t = scene / scale, t / scale
        color, name = ((BLUE, "the motion"), (ORANGE, "the second motion"))[place]
        axes[place].scatter(scene[:, 0], scene[:, 2], s=5, color=color)
        for R_, t_, label in ((np.eye(3), np.zeros(3), "1"), (R, t, "2")):
            _draw_camera(axes[place], R_, t_, label)
        axes[place].set(aspect="equal", xlim=(-2.6, 2.6), ylim=(-1.6, 4.6), xticks=[], yticks=[])
        axes[place].set_title(f"{name}: both images exactly explained", fontsize=8.5)
        pixels = 500 * _project(points, *third)
        noisy = pixels + rng.normal(0, 0.3, pixels.shape)
        residuals.append(_located(scene, noisy, *third))
    axes[2].bar([0, 1], [0.3, 0.3], color=GREY, width=0.35, label="in the two views")
    axes[2].bar([0.36, 1.36], residuals, color=[BLUE, ORANGE], width=0.35, label="in a third view")
    axes[2].set_xticks([0.18, 1.18], ["motion", "second"])
    axes[2].set(yscale="log", ylabel="residual (px, median)", ylim=(0.1, 100))
    for x, value in zip((0.36, 1.36), residuals, strict=True):
        axes[2].text(x, value * 1.15, f"{value:.1f}", ha="center", fontsize=8)
    axes[2].legend(fontsize=7.5, frameon=False, loc="upper left")
    axes[2].set_title("a third view decides", fontsize=8.5)
    return figure


def _pose(turn_deg: float, centre: tuple[float, float, float]) -> tuple[Floats, Floats]:
    """cam_from_world of a camera at a place, turned about the vertical axis."""
    R = rotation_from_vector(np.radians([0.0, turn_deg, 0.0]))
    return R, -R @ np.array(centre)


def _unit(rays: Floats) -> Floats:
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _project(points: Floats, R: Floats, t: Floats) -> Floats:
    seen = points @ R.T + t
    return seen[:, :2] / seen[:, 2:]


def _sorted(motions: Any, truth: tuple[Floats, Floats]) -> list[tuple[Floats, Floats, Floats]]:
    """The two motions, the true one first."""
    return sorted(motions, key=lambda motion: float(np.linalg.norm(motion[0] - truth[0])))


def _located(scene: Floats, pixels: Floats, R: Floats, t: Floats) -> float:
    """Median residual of a view after its pose is fitted to a scene, in pixels."""
    from scipy.optimize import least_squares

    def residuals(pose: Floats) -> Floats:
        return np.asarray((500 * _project(scene, rotation_from_vector(pose[:3]), pose[3:]) - pixels).ravel())

    found = least_squares(residuals, np.r_[vector_from_rotation(R), t], loss="soft_l1")
    return float(np.median(np.linalg.norm(residuals(found.x).reshape(-1, 2), axis=1)))


def _draw_camera(axes: Any, R: Floats, t: Floats, label: str) -> None:
    """A camera from above, as a triangle."""
    corners = np.array([[0, 0, 0], [-0.25, 0, 0.4], [0.25, 0, 0.4], [0, 0, 0]])
    world = (corners - t) @ R
    axes.plot(world[:, 0], world[:, 2], color="black", lw=1.2)
    axes.text(world[0, 0], world[0, 2] - 0.45, label, ha="center")


def _risk() -> Any:
    """The terms of the risk on two rendered worlds."""
    import matplotlib.pyplot as plt

    from slam_init import Initializer, open_source

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True)
    terms = {"direction": BLUE, "competing": ORANGE, "rotation": GREEN, "moving": GREY}
    for place, name in enumerate(("synth:rotate-then-move?slow_start=60", "synth:nadir-turn?slow_start=60")):
        source = open_source(name)
        assert source.camera is not None
        initializer = Initializer(source.camera)
        frames, rows = [], []
        for frame in source.frames():
            status = initializer.process(frame)
            window = status.window
            if status.attempt is not None and status.attempt.window is not None and window is not None:
                frames.append(frame.index)
                rows.append([window.risk, *(getattr(window, f"risk_{term}") for term in terms)])
            if status:
                break
        # The turning camera has a window at frame 4, and then none up to frame 60.
        first = next((k for k in range(1, len(frames)) if frames[k] - frames[k - 1] > 10), 0)
        frames, values = frames[first:], np.maximum(np.array(rows[first:]), 1e-6)
        axes[place].plot(frames, values[:, 0], "o-", color="black", lw=1.6, ms=3.5, label="risk")
        for column, (term, color) in enumerate(terms.items(), start=1):
            axes[place].plot(frames, values[:, column], color=color, lw=1.1, label=term)
        axes[place].axhline(0.005, color=RED, ls="--", lw=1, label="bound 0.005")
        axes[place].set(yscale="log", xlabel="frame", ylim=(7e-7, 1.6))
        axes[place].locator_params(axis="x", integer=True)
        axes[place].set_title(f"{name}: map after frame {frames[-1]}", fontsize=8.5)
    axes[0].set_ylabel("probability")
    axes[1].legend(fontsize=7.5, frameon=False, loc="lower left", ncols=2)
    return figure


if __name__ == "__main__":
    main()
