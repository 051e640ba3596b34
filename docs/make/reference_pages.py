"""Pages of the reference that are made from the code: command line, options, reasons, ``summary.json``."""

from __future__ import annotations

import argparse
import ast
import dataclasses
import json
import re
import sys
import tokenize
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def command_line() -> str:
    """Write the page of the command line from its parsers."""
    from slam_init.cli.main import make_parser

    parser = make_parser()
    lines = [
        "# Command line",
        "",
        "Made from the parsers of `slam_init/cli`. `python -m slam_init` is the same as `slam-init`.",
        "",
        *_usage(parser),
        str(parser.epilog),
        "",
    ]
    for name, command in commands(parser):
        lines += [f"## slam-init {name}", "", _text(command.description), "", *_usage(command)]
        lines += ["| argument | meaning |", "| --- | --- |", *_arguments(command), ""]
        if command.epilog:
            lines += [_text(command.epilog), ""]
    return "\n".join(lines)


def commands(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Give the commands and the commands below these, by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, command in action.choices.items():
                yield name, command
                yield from ((f"{name} {inner}", below) for inner, below in commands(command))


def _usage(parser: argparse.ArgumentParser) -> list[str]:
    return ["```text", parser.format_usage().removeprefix("usage: ").rstrip(), "```", ""]


def _arguments(parser: argparse.ArgumentParser) -> Iterator[str]:
    formatter = parser._get_formatter()
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction | argparse._HelpAction) or action.help == argparse.SUPPRESS:
            continue
        shown = str(action.metavar or (", ".join(map(str, action.choices)) if action.choices else "")).strip()
        if not shown and action.nargs != 0:
            shown = action.dest.upper()
        names = ", ".join(action.option_strings)
        meaning = formatter._expand_help(action) if action.help else ""
        yield f"| `{f'{names} {shown}'.strip() if names else shown}` | {_cell(meaning)} |"


def options() -> str:
    """Write the page of the options from ``slam_init/config.py``: each with the default and its reason."""
    from numpydoc.docscrape import NumpyDocString

    from slam_init import config

    file = ROOT / "slam_init" / "config.py"
    source = file.read_text(encoding="utf-8")
    comments = _comments(source)
    lines = [
        "# Options",
        "",
        "Every option with its default and the reason for it, made from `slam_init/config.py`. A run writes all "
        "options as `config.toml` beside its results; copy the file, edit it and pass it to `--config`. Keys that do "
        "not exist are refused. Names that end in `_px` are pixels of the original image.",
        "",
    ]
    top = NumpyDocString(config.Config.__doc__ or "")
    described = {item.name: " ".join(item.desc) for item in top["Attributes"]}
    lines += ["## Top level", "", "| key | default | meaning |", "| --- | --- | --- |"]
    for item in dataclasses.fields(config.Config):
        if item.default is not dataclasses.MISSING:
            text = f"{described[item.name]} {comments.get(('Config', item.name), '')}"
            lines.append(f"| `{item.name}` | `{_toml(item.default)}` | {_cell(text)} |")
    for section in dataclasses.fields(config.Config):
        if section.default_factory is dataclasses.MISSING:
            continue
        value = section.default_factory()
        cls = type(value)
        lines += [
            "",
            f"## {section.name}",
            "",
            _text(cls.__doc__),
            "",
            "| key | default | range | reason |",
            "| --- | --- | --- | --- |",
        ]
        for item in dataclasses.fields(cls):
            reason = comments.get((cls.__name__, item.name), "")
            key = f"{section.name}.{item.name}"
            low, high, why = item.metadata.get("range", ("", "", ""))
            span = f"{low:g} to {high:g}: {why}" if why else ""
            lines.append(f"| `{key}` | `{_toml(getattr(value, item.name))}` | {_cell(span)} | {_cell(reason)} |")
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    """A default as it stands in ``config.toml``, which has no null."""
    return "inf" if value is None else json.dumps(value)


def _comments(source: str) -> dict[tuple[str, str], str]:
    """(class, field) -> the ``#:`` comment above it; a field without one shares that of the field above."""
    lines = {
        token.start[0]: token.string[2:].strip()
        for token in tokenize.generate_tokens(StringIO(source).readline)
        if token.type == tokenize.COMMENT and token.string.startswith("#:")
    }
    found: dict[tuple[str, str], str] = {}
    for cls in ast.parse(source).body:
        if not isinstance(cls, ast.ClassDef):
            continue
        last = ""
        for field in cls.body:
            if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
                continue
            above = []
            row = field.lineno - 1
            while row in lines:
                above.insert(0, lines[row])
                row -= 1
            last = " ".join(above) or last
            found[cls.name, field.target.id] = last
    return found


def reasons() -> str:
    """Write the page of the reasons and of the gates."""
    from slam_init.types.refusal import REASONS, GateName

    lines = [
        "# Reasons and gates",
        "",
        "Why there is no map. The stage of an attempt that refuses it gives the reason. A run reports the most "
        "frequent reason of the second half of its attempts, and of equally frequent ones the first of this list.",
        "",
        "| reason | advice |",
        "| --- | --- |",
        *(f"| `{reason}` | {_cell(reason.advice)} |" for reason in REASONS),
        "",
        "## Gates",
        "",
        "The conditions of an attempt. Each is in `summary.json` with its value, its threshold and whether it passes.",
        "",
        "| gate | unit |",
        "| --- | --- |",
        *(f"| `{gate}` | {_cell(gate.unit) or '-'} |" for gate in GateName),
        "",
    ]
    return "\n".join(lines)


def summary() -> str:
    """Write the page of ``summary.json`` from its types."""
    if str(Path(__file__).parent) not in sys.path:  # mkdocs takes the folder of a hook off the path again
        sys.path.append(str(Path(__file__).parent))
    from summary_schema import summary_json_schema

    from slam_init.output.summary import SCHEMA

    schema = summary_json_schema()
    lines = [
        "# summary.json",
        "",
        f"Every key of layout {SCHEMA}, made from `slam_init/output/summary.py`.",
        "",
        "## The file",
        "",
        *_table(schema),
    ]
    for name, record in sorted(schema["$defs"].items()):
        lines += [f"## {name}", "", _text(record.get("description")), ""]
        if "properties" in record:
            lines += _table(record)
        elif "enum" in record:
            lines += ["One of " + ", ".join(f"`{value}`" for value in record["enum"]) + ".", ""]
    return "\n".join(lines)


def _table(record: dict[str, Any]) -> list[str]:
    rows = [
        f"| `{key}` | {_kind(value)} | {_cell(value.get('description', ''))} |"
        for key, value in record.get("properties", {}).items()
    ]
    return ["| key | type | meaning |", "| --- | --- | --- |", *rows, ""]


def _kind(value: dict[str, Any]) -> str:
    """The type of a value of the schema, in words."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(_kind(one) for one in value["anyOf"]))
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    if "enum" in value:
        return " or ".join(f"`{json.dumps(one)}`" for one in value["enum"])
    kind = value.get("type", "any")
    if kind == "array" and "prefixItems" in value:
        return "array of " + ", ".join(_kind(one) for one in value["prefixItems"])
    if kind == "array":
        return f"array of {_kind(value.get('items', {}))}"
    if kind == "object" and isinstance(value.get("additionalProperties"), dict):
        return f"object of {_kind(value['additionalProperties'])}"
    return " or ".join(kind) if isinstance(kind, list) else str(kind)


def _text(text: str | None) -> str:
    """The Markdown of text with marks of reStructuredText."""
    text = re.sub(r":(?:class|func|mod|attr|meth|data|exc):`~?([^`]+)`", r"`\1`", " ".join((text or "").split()))
    return text.replace("``", "`")


def _cell(text: str | None) -> str:
    """The same in a cell of a table."""
    return re.sub(r"\|", r"\\|", _text(text)).replace("<", "&lt;")
