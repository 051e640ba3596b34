"""The recipe for conda asks for what pyproject.toml asks for."""

import re
import tomllib

import pytest
import yaml
from paths import ROOT

pytestmark = pytest.mark.docs

#: Names of conda-forge that differ from those of PyPI.
NAMES = {"opencv-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def recipe():
    """The recipe, with the variables that it sets itself and those of conda filled in."""
    text = (ROOT / ".ci" / "conda" / "meta.yaml").read_text(encoding="utf-8")
    names = dict(re.findall(r'^{% set (\w+) = "(.*)" %}$', text, re.MULTILINE))
    text = re.sub(r"^{%.*$", "", text, flags=re.MULTILINE)
    return yaml.safe_load(re.sub(r"{{ *(\w+)[^}]*}}", lambda found: names.get(found[1], "python"), text))


def test_the_recipe_has_the_dependencies_the_version_and_the_command_of_the_project():
    content, project = recipe(), PROJECT["project"]
    wanted = {"python " + project["requires-python"]}
    for requirement in project["dependencies"]:
        name, bounds = re.fullmatch(r"([\w-]+)(.*)", requirement).groups()
        wanted.add(f"{NAMES.get(name, name.lower())} {bounds}")
    assert set(content["requirements"]["run"]) == wanted
    (setuptools,) = PROJECT["build-system"]["requires"]
    assert re.sub(r"(?=[<>=])", " ", setuptools, count=1) in content["requirements"]["host"]
    assert content["package"] == {"name": project["name"], "version": project["version"]}
    assert content["build"]["entry_points"] == [f"slam-init = {project['scripts']['slam-init']}"]
    assert (content["about"]["summary"], content["about"]["license"]) == (project["description"], project["license"])
