"""Makes the JSON Schema of ``summary.json`` from the types and docstrings of ``Summary``."""

from __future__ import annotations

import inspect
import re
from typing import Any, get_type_hints
from unittest.mock import patch

from numpydoc.docscrape import ClassDoc
from pydantic import JsonValue, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from typing_extensions import TypedDict

from quest.relative_pose import PoseEvidence
from slam_init.output import summary
from slam_init.types import evidence, refusal, result, scale, stopwatch

#: Where the types of the schema are defined.
_MODULES = (summary, evidence, refusal, result, scale, stopwatch)
#: Types whose floats may be null: a figure that is not finite is written as null.
_FIGURES = (
    "AttemptRecord",
    "Margin",
    "MapEvidence",
    "PoseEvidence",
    "PreviewEvidence",
    "FreeFocal",
    "TwoViewEvidence",
    "WindowEvidence",
)


def summary_json_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of :class:`Summary`, with descriptions from docstrings and comments."""
    # pydantic reads TypedDict of typing_extensions only (before Python 3.12), and has a type of its own for JSON.
    stage_times = TypedDict("StageTimes", get_type_hints(stopwatch.StageTimes))
    with patch.object(summary, "StageTimes", stage_times), patch.object(summary, "Json", JsonValue):
        schema = TypeAdapter(summary.Summary).json_schema(mode="serialization")
    for name, one in [("Summary", schema), *schema["$defs"].items()]:
        _describe(one, name)
        for value in one.get("properties", {}).values():
            _tidy(value, nullable=name in _FIGURES)
    schema["properties"]["schema"]["const"] = summary.SCHEMA
    return {"$schema": GenerateJsonSchema.schema_dialect, "$id": f"urn:slam-init:summary:{summary.SCHEMA}"} | schema


def _describe(schema: dict[str, Any], name: str) -> None:
    """Describe a type and its properties by the docstring and the comments of its class; allow no other keys."""
    if name == "JsonValue":
        schema["description"] = "Any JSON value."
        return
    classes = {"PoseEvidence": PoseEvidence} | {k: v for module in _MODULES for k, v in vars(module).items()}
    doc, comments = ClassDoc(classes[name]), _field_comments(classes[name])
    schema["description"] = _plain(" ".join([*doc["Summary"], *doc["Extended Summary"]]))
    if "properties" not in schema:
        return
    texts = {part.strip(): " ".join(item.desc) for item in doc["Attributes"] for part in item.name.split(",")}
    for key, value in schema["properties"].items():
        value["description"] = _plain((texts | comments)[key])
    schema["additionalProperties"] = False


def _field_comments(cls: type) -> dict[str, str]:
    """The ``#:`` comment above each field; a comment of several fields begins with their names and a colon."""
    comments: dict[str, str] = {}
    lines: list[str] = []
    for line in inspect.getsource(cls).splitlines():
        if line.startswith("    #:"):
            lines.append(line[6:].strip())
        elif lines:
            text, (field, *_) = " ".join(lines), line.strip().partition(":")
            names, shared, meaning = text.partition(": ")
            several = shared and re.fullmatch(r"\w+(, \w+)+", names)
            comments |= dict.fromkeys(names.split(", "), meaning) if several else {field: text}
            lines = []
    return comments


def _tidy(schema: dict[str, Any], *, nullable: bool) -> None:
    """Remove generated titles; let numbers be null where a figure may not be finite."""
    schema.pop("title", None)
    if nullable and schema.get("type") == "number":
        schema["type"] = ["number", "null"]


def _plain(text: str) -> str:
    """A docstring without the markup of Sphinx (roles, doubled backquotes), and with null for None."""
    text = re.sub(r":\w+:`~?([^`]*)`", r"\1", re.sub(r"\s+", " ", text))
    return re.sub(r"\bNone\b", "null", text.replace("``", "`")).strip()
