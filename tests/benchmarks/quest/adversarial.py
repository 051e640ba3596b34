"""Adversarial inputs: ``python -m tests.benchmarks.quest.adversarial`` makes 10^5 calls to ``quest``.

Each input is a degenerate or an ordinary scene in a hostile form. A call passes if it returns a valid answer (see
:func:`defect_of`) or raises :class:`quest.InputError`. Any other exception, any warning, and an answer to an
input without meaning count as broken. The report names the number of each broken call, with which it can be repeated.
"""

from __future__ import annotations

import argparse
import inspect
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

import quest
from slam_init.output.tables import markdown_table
from tests.benchmarks.options import positive, progress, run_on_one_thread, save

Floats = NDArray[np.float64]
#: Two views in any form that a caller could pass: arrays, lists, numbers, texts.
Views = tuple[object, object]

#: The functions that take pixels.
_PIXELS = ("estimate_relative_pose_px", "estimate_shared_focal")

#: Every function of the package by its name, with the classical solvers of :data:`quest.SOLVERS`.
FUNCTIONS: dict[str, Callable[..., object]] = {
    **{name: getattr(quest, name) for name in quest.__all__ if inspect.isfunction(getattr(quest, name))},
    **{name: solver.function for name, solver in quest.SOLVERS.items()},
}


_KINDS = ("box", "plane", "line", "repeated", "one point", "two points", "far", "at the camera")
#: Rays that belong to no scene: (N, 3) of the first view -> of the second.
_RAYS: dict[str, Callable[[Floats, np.random.Generator], tuple[Floats, Floats]]] = {
    "all equal": lambda X, rng: (0 * X + [0.1, 0.2, 1.0], 0 * X + rng.normal(size=3)),
    "two clusters": lambda X, rng: (_clusters(X, rng), _clusters(X, rng)),
    "nearly equal": lambda X, rng: (X[:1] + 1e-9 * rng.normal(size=X.shape), X[:1] + 1e-9 * rng.normal(size=X.shape)),
    "antipodal": lambda X, rng: (X, -X),
    "opposite pairs": lambda X, rng: (X[:1] * rng.choice([-1, 1], (len(X), 1)), X[:1] + 0 * X),
    "on the epipoles": lambda X, rng: (
        0 * X + [0.0, 0.0, 1.0],
        np.where(rng.random((len(X), 1)) < 0.5, [0, 0, 1.0], X),
    ),
    "mirrored": lambda X, rng: (X, X * [1, 1, -1]),
    "great circles": lambda X, rng: (X * [1, 0, 1], X @ rng.normal(size=(3, 2)) @ rng.normal(size=(2, 3))),
}


def _clusters(X: Floats, rng: np.random.Generator) -> Floats:
    return np.asarray(rng.normal(size=(2, 3))[np.arange(len(X)) % 2])


def _scene(rng: np.random.Generator) -> tuple[str, Floats, Floats]:
    """A scene and its two views (N, 3), points in each camera's frame."""
    count = int(rng.choice([0, 1, 2, 5, 6, 6, 6, 7, 8, 10, 12, 20, 40]))
    X = rng.uniform([-1, -1, 1], [1, 1, 4], (count, 3))
    kind = str(rng.choice(_KINDS))
    if kind == "plane":
        X[:, 2] = 2 + X[:, :2] @ rng.uniform(-0.5, 0.5, 2)
    elif kind == "line":
        X = rng.uniform(-1, 1, (count, 1)) * rng.normal(size=3) + [0, 0, 3]
    elif kind == "repeated" and count:
        X = X[rng.integers(0, max(1, count // 3), count)]
    elif kind in ("one point", "two points") and count:
        X = X[rng.integers(0, 1 + (kind == "two points"), count) % count]
    elif kind == "far":
        X *= 1e12
    elif kind == "at the camera":
        X *= 1e-12
    if rng.random() < 0.3 and count:
        kind = str(rng.choice(list(_RAYS)))
        return kind, *_RAYS[kind](X, rng)
    angle = float(rng.choice([0, 1e-9, 0.1, np.pi / 2, np.pi]))
    axis = rng.normal(size=3) if rng.random() < 0.5 else rng.permutation([1.0, 0.0, 0.0])
    turn = _rotation(axis / np.linalg.norm(axis), angle)
    t = rng.normal(size=3) * float(rng.choice([0, 1e-12, 1e-3, 0.3, 3]))
    Y = X @ turn.T + t
    noise = float(rng.choice([0, 1e-16, 1e-3, 1]))
    motion = f"{kind}, turn {angle:.2g}, noise {noise:g}"
    if rng.random() < 0.1:
        Y = Y[rng.permutation(count)]
    return motion, X, Y + noise * rng.normal(size=Y.shape)


def _rotation(axis: Floats, angle: float) -> Floats:
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)


def _read_only(a: Floats) -> Floats:
    a = a.copy()
    a.setflags(write=False)
    return a


def _with_value(a: Floats, value: float) -> Floats:
    a = a.copy()
    a[-1:] = value
    return a


#: Forms of valid numbers.
_HARMLESS: dict[str, Callable[[Floats], object]] = {
    "plain": lambda a: a,
    "float32": lambda a: a.astype(np.float32),
    "float16": lambda a: np.clip(a, -6e4, 6e4).astype(np.float16),
    "long double": lambda a: a.astype(np.longdouble),
    "integer": lambda a: np.rint(np.clip(100 * a, -1e9, 1e9)).astype(np.int64),
    "big endian": lambda a: a.astype(">f8"),
    "read-only": _read_only,
    "strided": lambda a: np.repeat(np.repeat(a, 2, axis=0), 2, axis=1)[::2, ::2],
    "reversed": lambda a: a[::-1],
    "Fortran order": np.asfortranarray,
    "object": lambda a: a.astype(object),
    "list": lambda a: a.tolist(),
    "masked, no mask": np.ma.asarray,
    "huge": lambda a: a * 1e290,
    "tiny": lambda a: a * 1e-290,
    "denormal": lambda a: a * 1e-308,
    "mixed scales": lambda a: a * np.logspace(-150, 150, len(a))[:, None] if len(a) else a,
    "one coordinate huge": lambda a: np.clip(a, -1e7, 1e7) * [1e300, 1e-300, 1.0],
    "batch": lambda a: np.stack([a, a[::-1]]),
}
#: Forms without meaning: a call must raise InputError.
_HARMFUL: dict[str, Callable[[Floats], object]] = {
    "NaN": lambda a: _with_value(a, np.nan),
    "infinite": lambda a: _with_value(a, np.inf),
    "zero ray": lambda a: _with_value(a, 0.0),
    "masked": lambda a: np.ma.masked_array(a, mask=np.ones_like(a, bool)),
    "complex": lambda a: a + 1j,
    "text": lambda a: a.astype(str),
    "objects": lambda a: np.full(a.shape, None),
    "too large for a double": lambda a: np.full(a.shape, 10**400, object),
    "dates": lambda a: np.zeros(a.shape, "datetime64[s]"),
    "flat": np.ravel,
    "transposed": lambda a: np.concatenate([a, a, a, a[:1]]).T,
    "pixels": lambda a: a[:, :2],
    "four columns": lambda a: np.column_stack([a, a[:, :1]]),
    "ragged": lambda a: [*a.tolist(), [1.0]],
    "nothing": lambda a: None,
    "a number": lambda a: 1.0,
    "a word": lambda a: "bearings",
    "a dictionary": lambda a: {"m": a},
    "four dimensions": lambda a: a[None, None],
}


#: Forms that are for rays alone, and do no harm to pixels or do not fit them.
_FOR_RAYS = ("zero ray", "pixels", "one coordinate huge")


def draw_input(rng: np.random.Generator, *, pixels: bool = False) -> tuple[str, bool, Views]:
    """Draw an input: its description, whether it is without meaning, and the matched rays or pixels in some form."""
    scene, X, Y = _scene(rng)
    harmful = bool(rng.random() < 0.4) and len(X) > 0
    forms = _HARMFUL if harmful else _HARMLESS
    form = str(rng.choice([form for form in forms if not (pixels and form in _FOR_RAYS)]))
    if pixels:
        X, Y = 300 * X[:, :2], 300 * Y[:, :2]
    views = forms[form](X), forms[form](Y)
    if harmful and rng.random() < 0.5:  # one valid view does not make the input valid
        views = (X, views[1]) if rng.random() < 0.5 else (views[0], Y)
    return f"{form}: {scene}, {len(X)} matches", harmful, views


def call(name: str, views: Views, rng: np.random.Generator) -> object:
    """Call a function of the package on two views; the other arguments are ordinary or hostile."""
    function = FUNCTIONS[name]
    hostile = [0, -1.0, np.nan, np.inf, "1", None, 1e300, 1e-300, True, [1.0], 10**400, np.array([1.0, 2.0])]
    odd = hostile[int(rng.integers(len(hostile)))] if rng.random() < 0.2 else ...
    if name == "estimate_relative_pose":
        options = {} if odd is ... else {str(rng.choice(["threshold_rad", "confidence", "max_samples", "seed"])): odd}
        return function(*views, **options)
    if name == "refine_relative_pose":
        given = (_quaternions(rng)[0], rng.normal(size=3))
        return function(*views, given if odd is ... else (odd, given[1]) if rng.random() < 0.5 else odd)
    if name == "estimate_relative_poses":
        (pose,) = cast(list[object], function([views], threads=1 if odd is ... else odd))
        return pose
    if name == "estimate_upright_pose":
        return function(*views, rng.normal(size=3), rng.normal(size=3) if odd is ... else odd)
    if name == "estimate_shared_focal":
        return function(*views, (0.0, 0.0) if odd is ... else odd)
    if name == "estimate_relative_pose_px":
        cameras: list[object] = [np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])] * 2
        if odd is not ...:
            cameras[int(rng.integers(2))] = odd if rng.random() < 0.5 else np.full((3, 3), 1e300)
        return function(*views, *cameras)
    if name == "translation_and_depths_printed":
        return function(_quaternions(rng)[0] if odd is ... else odd, *views)
    if name == "translation_and_depths":
        return function(_quaternions(rng) if odd is ... else odd, *views)
    if name == "parallax_statement":
        t = rng.normal(size=3) * float(rng.choice([1, 1e300, 1e-300]))
        arguments: list[object] = [_quaternions(rng)[0], t]
        options = {}
        if odd is not ...:
            place = int(rng.integers(5))
            if place < 2:
                arguments[place] = odd
            else:
                options = {("noise_rad", "chance_matches", "wrong_matches")[place - 2]: odd}
        return function(*arguments, *views, **options)
    return function(*views)


def _quaternions(rng: np.random.Generator) -> Floats:
    scale = float(rng.choice([1, 1e300, 1e-300]))
    return np.asarray(scale * np.array([rng.normal(size=4), np.eye(4)[int(rng.integers(4))]]))


def defect_of(result: object) -> str | None:
    """What is invalid in an answer, or None: a number that is not finite, a rotation that is no rotation."""
    if isinstance(result, quest.NoPose):
        return None
    if isinstance(result, quest.RelativePose):
        poses: list[quest.RelativePose | quest.Hypothesis] = [result, *result.alternatives]
        if not all(_unit(p.q_wxyz) and (_unit(p.t) or not p.t.any()) for p in poses):
            return "an invalid pose"
        if not all(is_rotation(p.R) for p in poses):
            return "a matrix that is no rotation"
        if result.kind != "rotation" and not np.isfinite(result.covariance).all():
            return "a covariance that is not finite"
        return None if np.isfinite([result.noise_rad, result.parallax_rad]).all() else "a statistic that is not finite"
    if isinstance(result, quest.SharedFocal):
        known = np.isfinite(result.focal_px) and result.focal_px > 0 and not np.isnan(result.sigma_px)
        return defect_of(result.pose) if known else "no focal length"
    if isinstance(result, quest.ParallaxStatement):
        if not (0 <= result.p_value <= 1 and np.isfinite(result.test_value) and result.noise_rad > 0):
            return "an invalid test"
        known = np.isfinite(result.ratio) and result.ratio_sigma >= 0
        return None if known or result.ratio_sigma == np.inf else "a ratio that is not finite"
    if isinstance(result, tuple):
        t, u, v = result
        norm = np.linalg.norm(t, axis=-1)
        # As the paper has them, translation and depths have a norm of 1 together.
        whole = np.linalg.norm(np.concatenate([t, u, v], axis=-1), axis=-1)
        fine = (np.abs(norm - 1) < 1e-9) | (norm == 0) | (np.abs(whole - 1) < 1e-9)
        return None if fine.all() and u.shape == v.shape else "an invalid translation"
    if not isinstance(result, np.ndarray):
        return f"an answer of the type {type(result).__name__}"
    rows = result.reshape(-1, 4)
    if result.ndim == 3:
        rows = rows[~np.isnan(rows).all(axis=1)]
    return None if all(_unit(q) for q in rows) else "an invalid quaternion"


def is_rotation(R: Floats) -> bool:
    """Whether ``R R^T = 1`` and ``det R = 1`` to 1e-9."""
    orthonormal = np.isfinite(R).all() and np.abs(R @ R.T - np.eye(3)).max() < 1e-9
    return bool(orthonormal and abs(np.linalg.det(R) - 1) < 1e-9)


def _unit(a: Floats) -> bool:
    return bool(abs(np.linalg.norm(a) - 1) < 1e-9)


def judge(name: str, seed: int, index: int) -> tuple[str, str]:
    """Outcome of one call ("answer", "InputError" or "broken") and, of a broken one, what happened."""
    rng = np.random.default_rng([seed, index])
    what, harmful, views = draw_input(rng, pixels=name in _PIXELS)
    with warnings.catch_warnings(), np.errstate(divide="warn", over="warn", invalid="warn"):
        warnings.simplefilter("error")
        try:
            result = call(name, views, rng)
        except quest.InputError as error:
            return ("InputError", "") if "\n" not in str(error) else ("broken", f"message of several lines ({what})")
        # Any other exception is a defect.
        except Exception as error:
            return "broken", f"{type(error).__name__}: {error} ({what})"
    if harmful:
        return "broken", f"accepted an input without meaning ({what})"
    problem = defect_of(result)
    return ("answer", "") if problem is None else ("broken", f"{problem} ({what})")


def main(argv: Sequence[str] | None = None) -> int:
    """Make the calls and print the number of outcomes; the exit code is 1 if a call was broken."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quest.adversarial", allow_abbrev=False)
    parser.description = "Random and adversarial inputs to every function of quest."
    parser.add_argument("--inputs", type=positive, default=100_000, metavar="N", help="in all (default 100000)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the inputs (default 0)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write adversarial.md there")
    options = parser.parse_args(argv)
    outcomes: Counter[tuple[str, str]] = Counter()
    broken: list[str] = []
    names = tuple(FUNCTIONS)
    for index in progress(range(options.inputs), "input"):
        name = names[index % len(names)]
        outcome, what = judge(name, options.seed, index)
        outcomes[name, outcome] += 1
        if what:
            broken.append(f"{name}, input {index}: {what}")
    kinds = ("answer", "InputError", "broken")
    rows = [[name, *(str(outcomes[name, kind]) for kind in kinds)] for name in FUNCTIONS]
    table = markdown_table(["function", *kinds], rows)
    save(options.out, "adversarial.md", "\n".join([table, *(f"- {line}" for line in broken[:20])]) + "\n")
    return 1 if broken else 0


if __name__ == "__main__":
    run_on_one_thread()
    sys.exit(main())
