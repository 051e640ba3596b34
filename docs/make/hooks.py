"""Hooks of mkdocs: navigation, pages made from the code, links that leave the folder, mathematics.

* An entry of the navigation whose page is absent is left out; a page without an entry is added below "More".
* :mod:`reference_pages` makes the pages of the command line, the options, the reasons and ``summary.json``.
* Documents elsewhere in the repository (measured tables, README of quest, CONTRIBUTING, ...) become pages as they are.
* A link to a file of the repository that is no page becomes its path, since the site does not hold the sources.
* LaTeX becomes MathML, which browsers show without a script.
* A measurement says so where the core has changed since its commit.
* A page that would fetch something from another host fails a strict build.
"""

from __future__ import annotations

import html
import logging
import posixpath
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numbers_page  # beside this file: mkdocs puts the folder of a hook on the path while it loads the hook
import reference_pages
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]

log = logging.getLogger("mkdocs.hooks.slam_init")

#: Documents of the repository that are pages of the site: file -> page.
DOCUMENTS = {
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "quest/README.md": "quest.md",
}
#: Pages that are made from the code: module -> page.
OF_CODE = {
    "slam_init/cli/parser.py": "reference/command-line.md",
    "slam_init/config.py": "reference/options.md",
    "slam_init/types/refusal.py": "reference/reasons.md",
    "slam_init/output/summary.py": "reference/summary.md",
    "slam_init/window/levels.py": "reference/numbers.md",
}
MEASURED = ("tests/benchmarks/measured", "tests/benchmarks/quest/measured")
#: The code that decides on a pose of two views, and on a map: a measurement may change with it.
CORE_OF_QUEST = ("quest/*.py",)
CORE = (
    *CORE_OF_QUEST,
    *(f"slam_init/{folder}/*.py" for folder in ("window", "decision", "bundle", "mapping", "frontend")),
)
#: Measurements of two views.
OF_QUEST = ("measurements/two-views.md", "tests/benchmarks/quest/", "tests/benchmarks/measured/real_pairs.md")

_LINK = re.compile(r"(?P<image>!?)\[(?P<text>[^\]\[]*)\]\((?P<target>[^)\s]+)\)")
_FENCE = re.compile(r"^(```.*?^```)$", re.DOTALL | re.MULTILINE)
_MATH = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
_ROLE = re.compile(r":(?:class|func|mod|attr|meth|data|exc):<code>~?([^<]+)</code>")
#: The commit of a section of ``docs/measurements``, and the first one that a measured table names.
_COMMIT = re.compile(r"^\* Commit: ([0-9a-f]{7,40}).*$", re.MULTILINE)
_NAMED_COMMIT = re.compile(r"\bcommit:? `?([0-9a-f]{7,40})\b", re.IGNORECASE)
_FETCHED = re.compile(
    r"""<(?:script|img|iframe|source|video)\b[^>]*\bsrc=["'](?:https?:)?//|<link\b(?![^>]*rel=["']canonical)"""
    r"""[^>]*\bhref=["'](?:https?:)?//|url\(["']?(?:https?:)?//""",
    re.IGNORECASE,
)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Leave out entries of the navigation without a page, and add the pages without an entry."""
    sys.path.insert(0, str(ROOT))  # the code beside the documents, and not an installed version
    docs = Path(config.docs_dir)
    pages = {page.relative_to(docs).as_posix() for page in docs.rglob("*.md") if "make" not in page.parts}
    pages |= {made for made, _ in _made()}
    nav = _present(config.nav or [], pages)
    more = sorted(pages - set(_pages_of(nav)))
    config.nav = [*nav, {"More": more}] if more else nav
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from the code and from documents elsewhere, and the pictures of the latter."""
    for page, content in _made():
        if files.get_file_from_path(page) is None:
            files.append(File.generated(config, page, content=content))
    for folder in MEASURED:
        for picture in sorted((ROOT / folder).glob("*.png")):
            files.append(File.generated(config, f"measured/{picture.name}", abs_src_path=str(picture)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links that leave the folder to their page, or show the path; say where a measurement is old."""
    uri = page.file.src_uri
    if uri.startswith("measurements/"):
        markdown = _COMMIT.sub(lambda head: f"{head[0]}.{_age(head[1], uri)}", markdown)
    origin = _origins().get(uri, f"docs/{uri}")

    def led(match: re.Match[str]) -> str:
        target, _, anchor = match["target"].partition("#")
        if not target or re.match(r"[a-z]+:", target):
            return match[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
        to = _page_of(path)
        if to is not None and (files.get_file_from_path(to) is not None):
            relative = posixpath.relpath(to, posixpath.dirname(uri) or ".")
            return f"{match['image']}[{match['text']}]({relative}{'#' + anchor if anchor else ''})"
        if path.startswith("docs/") or not (ROOT / path).exists():
            return match[0]  # mkdocs warns
        text = match["text"].strip("`")
        return f"`{path}`" if text in path else f"{match['text']} (`{path}`)"

    parts = _FENCE.split(markdown)
    return "".join(part if index % 2 else _LINK.sub(led, part) for index, part in enumerate(parts))


def on_page_content(html_text: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn LaTeX into MathML, and what is left of reStructuredText in docstrings into plain text."""
    from latex2mathml.converter import convert

    def mathml(match: re.Match[str]) -> str:
        display = "block" if match[2] == "[" else "inline"
        return convert(html.unescape(match[3]).strip(), display=display)

    html_text = _MATH.sub(mathml, html_text)
    html_text = _ROLE.sub(r"<code>\1</code>", html_text)
    html_text = html_text.replace(" ::</p>", ":</p>").replace("::</p>", ":</p>").replace("<p>.. [", "<p>[")
    # Wide tables scroll on their own and not with the page.
    return html_text.replace("<table>", '<div class="wide" tabindex="0"><table>').replace("</table>", "</table></div>")


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Warn of what a page would fetch from another host."""
    found = _FETCHED.search(output)
    if found:
        log.warning("%s fetches from another host: %s", page.file.src_uri, output[found.start() : found.end() + 60])
    return output


def _age(commit: str, place: str) -> str:
    """What a measurement of a commit says of its age; nothing where the core has not changed since."""
    core = CORE_OF_QUEST if place.startswith(OF_QUEST) else CORE
    last, _, date = _git("log", "-1", "--format=%h %as", "--", *core).partition(" ")
    if not last or not _git("rev-parse", "--verify", "--quiet", f"{commit}^{{commit}}"):
        return ""  # no repository, or a shallow copy
    if _git("merge-base", last, commit) == _git("rev-parse", last):
        return ""
    return f" **Older than the core**, which has changed since, last on {date}."


@cache
def _git(*arguments: str) -> str:
    """What git prints, or nothing where it fails."""
    try:
        run = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return run.stdout.strip() if run.returncode == 0 else ""


def _origins() -> dict[str, str]:
    """Page -> file of the repository, for pages whose file is outside of docs/."""
    measured = {f"measured/{file.name}": f"{folder}/{file.name}" for folder in MEASURED for file in _tables(folder)}
    return {page: file for file, page in DOCUMENTS.items() if (ROOT / file).exists()} | measured


def _tables(folder: str) -> list[Path]:
    return sorted((ROOT / folder).glob("*.md"))


def _page_of(path: str) -> str | None:
    """The page or picture of the site that shows a file of the repository."""
    if path in ("README.md", "docs"):
        return "index.md"
    if path in OF_CODE:
        return OF_CODE[path]
    for page, origin in _origins().items():
        if origin == path:
            return page
    folder, _, name = path.rpartition("/")
    if folder in MEASURED:
        return f"measured/{name}"
    return path.removeprefix("docs/") if path.startswith("docs/") else None


def _made() -> Iterator[tuple[str, str]]:
    """The pages without a file in docs/, each with its Markdown."""
    yield "reference/command-line.md", reference_pages.command_line()
    yield "reference/options.md", reference_pages.options()
    yield "reference/reasons.md", reference_pages.reasons()
    yield "reference/summary.md", reference_pages.summary()
    yield "reference/numbers.md", numbers_page.page()
    for page, origin in _origins().items():
        text = (ROOT / origin).read_text(encoding="utf-8")
        if page.startswith("measured/"):
            name = Path(origin).stem.replace("_", " ")
            # One heading of the first level, which is the title in the navigation.
            text = re.sub(r"^# ", "## ", text, flags=re.MULTILINE) if text.startswith("# ") else text
            commit = _NAMED_COMMIT.search(text)
            age = _age(commit[1] if commit else _git("log", "-1", "--format=%h", "--", origin), origin)
            text = f"# {name.capitalize()}\n\nThe file `{origin}` of the repository.{age}\n\n{text}"
        yield page, text


def _present(nav: list[Any], pages: set[str]) -> list[Any]:
    """The entries of a navigation whose page exists, and the sections that are not empty."""
    kept: list[Any] = []
    for item in nav:
        if isinstance(item, str):
            kept += [item] if item in pages else []
            continue
        for title, value in item.items():
            inner = _present(value if isinstance(value, list) else [value], pages)
            kept += [{title: inner if isinstance(value, list) else value}] if inner else []
    return kept


def _pages_of(nav: list[Any]) -> Iterator[str]:
    for item in nav:
        for value in item.values() if isinstance(item, dict) else (item,):
            if isinstance(value, list):
                yield from _pages_of(value)
            else:
                yield value
