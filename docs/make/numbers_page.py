"""The page of the numbers: every number that decides on a map, from the comments above the numbers.

A number is on the page if its ``#:`` comment names a class, or if :data:`MORE` does. The site makes the page when it
is built; ``python docs/make/numbers_page.py`` prints it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LEVELS = "slam_init/window/levels.py"
CLASSES = ("definition", "geometry", "level", "measured", "assumption", "budget")

#: Class and unit of numbers whose own comments name none, by their package: fields of classes, and those of quest. It
#: knows no maps.
MORE = {
    "slam_init/types": {
        "Margin.LOG_LIKELIHOOD_NEEDED": "level, in nats",
        "Margin.z_needed": "level, in standard deviations",
    },
    "slam_init/window": {
        "TUKEY_GATES": "definition",
        "_NO_SHIFT": "assumption, over the width",
        "_LEAST_DISTORTION": "level, as k1",
    },
    "slam_init/bundle": {
        "_WORST_NOISE": "assumption",
        "_LARGEST_LEVERAGE": "measured",
        "CAUCHY": "level, in standard deviations",
    },
    "quest": {
        "_ERROR_RATE": "level",
        "_LEAST_NOISE": "assumption, in thresholds",
        "_MIN_MATCHES": "measured",
        "_LEAST_SHARE": "assumption",
        "_LINE_SIGMAS": "measured",
        "LARGEST_OF_MOTION": "level",
        "_VARIATION_SIGMAS": "level",
        "_DROPPED_SIGMAS": "level",
        "SAME_FIT_NATS": "level",
        "KERNEL_SIGMAS": "measured",
        "SCALE": "measured, in thresholds",
        "OUTLIERS": "assumption",
        "REACH": "assumption, in thresholds",
        "GATE_SIGMAS": "level",
        "_LEAST_PARALLAX_SIGMAS": "measured",
        "_NEAR_SIGMAS": "level",
        "_FAR_SIGMAS": "level",
        "_FAVOURED_DEVIATE": "level",
        "_RATIO_MADS": "assumption",
    },
}
#: Places of the numbers, in the order of the page.
FILES = (
    LEVELS,
    *(f"slam_init/{folder}" for folder in ("decision", "window", "types", "frontend", "mapping", "bundle")),
    "quest",
)
_UNITS = {"DEG": "degrees", "PX": "px", "RAD": "rad", "S": "s", "SIGMAS": "standard deviations", "NATS": "nats"}
_CLASS = re.compile(r"Class: (\w+)(?:, (?:in )?([^.]+))?\.$")


@dataclass(frozen=True)
class Number:
    """A statement that gives numbers names."""

    file: str
    #: What the section of the module is called; empty without one.
    section: str
    names: tuple[str, ...]
    value: str
    reason: str
    #: One of :data:`CLASSES`; empty where the number does not decide.
    kind: str
    unit: str


def numbers(file: str) -> Iterator[Number]:
    """Read the numbers of a module: its constants, and the fields of its classes that :data:`MORE` names."""
    source = (ROOT / file).read_text(encoding="utf-8")
    lines, more = source.splitlines(), next((more for place, more in MORE.items() if file.startswith(f"{place}/")), {})
    last = ""
    for names, statement in _statements(ast.parse(source)):
        comment = _comment(lines, statement.lineno) or _described(source, names[0]) or last
        last = comment
        found = _CLASS.search(comment)
        stated = more.get(names[0])
        if "." in names[0] and stated is None:
            continue
        if found is None and stated is not None:
            found = _CLASS.search(f"Class: {stated}.")
        kind, unit = (found[1], found[2] or _unit(names)) if found else ("", "")
        section = next((row.strip("# -") for row in lines[statement.lineno :: -1] if row.startswith("# -- ")), "")
        yield Number(file, section, names, _value(statement.value), _CLASS.sub("", comment).strip(), kind, unit)


def _statements(tree: ast.Module) -> Iterator[tuple[tuple[str, ...], ast.Assign | ast.AnnAssign]]:
    """The assignments of numbers to upper-case names, and to fields of classes, each with its names."""
    for statement in tree.body:
        inner = statement.body if isinstance(statement, ast.ClassDef) else [statement]
        prefix = f"{statement.name}." if isinstance(statement, ast.ClassDef) else ""
        for one in inner:
            if not isinstance(one, ast.Assign | ast.AnnAssign) or one.value is None:
                continue
            targets = one.targets if isinstance(one, ast.Assign) else [one.target]
            names = tuple(node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name))
            parts = [node for node in ast.walk(one.value) if isinstance(node, ast.Constant)]
            is_number = any(isinstance(part.value, int | float) and part.value is not True for part in parts)
            if names and is_number and (prefix or names[0].lstrip("_").isupper()):
                yield tuple(prefix + name for name in names), one


def _comment(lines: list[str], line: int) -> str:
    """The ``#:`` comment above a line."""
    above: list[str] = []
    for row in reversed(lines[: line - 1]):
        if not row.lstrip().startswith("#:"):
            break
        above.insert(0, row.lstrip().removeprefix("#:").strip())
    return " ".join(above)


def _described(source: str, name: str) -> str:
    """What the docstring of a class says of a field; empty for a constant."""
    found = re.search(rf"^    {name.partition('.')[2]} : .*\n((?:        .*\n)+)", source, re.MULTILINE)
    return " ".join(found[1].split()) if found and "." in name else ""


def _unit(names: tuple[str, ...]) -> str:
    units = [_UNITS.get(name.upper().rpartition("_")[2], "") for name in names]
    return units[0] if len(set(units)) == 1 else ", ".join(unit or "1" for unit in units)


def _value(value: ast.expr | None) -> str:
    if isinstance(value, ast.Call) and ast.unparse(value.func) == "np.array":
        value = value.args[0]
    parts = value.elts if isinstance(value, ast.Tuple | ast.List) else [value]
    return ", ".join(ast.unparse(part) for part in parts if part is not None)


def files() -> Iterator[str]:
    """Give the modules of the page, each once."""
    seen = set()
    for place in FILES:
        for path in sorted((ROOT / place).rglob("*.py")) if (ROOT / place).is_dir() else [ROOT / place]:
            file = path.relative_to(ROOT).as_posix()
            if file not in seen:
                seen.add(file)
                yield file


def page() -> str:
    """Write the page: of each number the first sentence of its comment."""
    title = "# Numbers that decide"
    intro = ast.get_docstring(ast.parse((ROOT / LEVELS).read_text(encoding="utf-8"))) or ""
    classes = re.findall(r"^\* .*$", intro, re.MULTILINE)
    lines = [
        title,
        "",
        "Made from the comments in the code. Options are for users ([their page](options.md)). The numbers of this "
        "page are for those who change the decision. The comment in the code has the whole reason. Each number has a "
        "class:",
        "",
        *classes,
    ]
    place = ("", "")
    for number in (number for file in files() for number in numbers(file) if number.kind):
        if (number.file, number.section) != place:
            if number.file != place[0]:
                lines += ["", f"## `{number.file}`"]
            if number.section:
                lines += ["", f"### {number.section[0].upper()}{number.section[1:]}"]
            lines += ["", "| number | value | unit | class | reason |", "| --- | --- | --- | --- | --- |"]
            place = (number.file, number.section)
        names = ", ".join(f"`{name}`" for name in number.names)
        reason = _cell(_first_sentence(number.reason))
        lines.append(f"| {names} | {number.value} | {number.unit} | {number.kind} | {reason} |")
    return "\n".join(lines) + "\n"


def _first_sentence(text: str) -> str:
    return re.split(r"(?<=\.) (?=[A-Z])", text, maxsplit=1)[0]


def _cell(text: str) -> str:
    return re.sub(r":(?:mod|func|data|class):`~?([^`]+)`", r"`\1`", text).replace("``", "`").replace("|", "\\|")


if __name__ == "__main__":
    print(page(), end="")
