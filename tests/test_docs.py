"""What pages and docstrings say is so: links, files, modules, names and examples in them."""

import doctest
import re
import tomllib
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
TREES = ("scaleup", "plugins", "geometries", "tests", "benchmarks", "tools", "docs")
PAGES = [REPOSITORY / "README.md", REPOSITORY / "CONTRIBUTING.md", *REPOSITORY.glob("docs/**/*.md")]
CODE = [path for tree in TREES for path in (REPOSITORY / tree).rglob("*.py")]

WITH_EXAMPLES = [
    inside.with_suffix("").as_posix().replace("/", ".")
    for inside in (path.relative_to(REPOSITORY) for path in CODE)
    if inside.parts[0] == "scaleup" and ">>> " in (REPOSITORY / inside).read_text("utf-8")
]


def relative(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


@cache
def anchors(page: Path) -> set[str]:
    """What GitHub calls the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title).lower().replace(" ", "-") for title in headings}


@cache
def entry_point_groups() -> set[str]:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    return set(project["project"]["entry-points"])


def found(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    try:
        resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), f"{target}: no such file"
        assert not anchor or anchor in anchors(linked), f"{target}: no such heading"


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_pages_name_files_that_exist(page):
    names = {path.name for path in CODE}
    for path in set(re.findall(r"[\w./-]+\.py\b", page.read_text(encoding="utf-8"))):
        places = (REPOSITORY, REPOSITORY / "scaleup", page.parent)
        exists = any((place / path).is_file() for place in places)
        assert exists or path in names, f"{path}: no such file"


def test_code_names_files_that_exist():
    path_to = re.compile(rf"(?<![\w/.-])(?:{'|'.join(TREES)})/[\w./-]*\.(?:py|md|png|toml)\b")
    missing = {
        f"{relative(path)}: {named}"
        for path in CODE
        for named in path_to.findall(path.read_text(encoding="utf-8"))
        if not (REPOSITORY / named).exists() and not (path.parent / named).exists()
    }
    assert not missing


def test_names_within_scaleup_exist():
    dotted = re.compile(r"(?<![\w.\"/-])scaleup(?:\.[A-Za-z_]\w*)+")
    skipped = entry_point_groups()
    missing = {
        f"{relative(path)}: {name}"
        for path in (*PAGES, *CODE)
        for name in dotted.findall(path.read_text(encoding="utf-8"))
        if name not in skipped and not found(name)
    }
    assert not missing


def test_every_room_is_described():
    page = (REPOSITORY / "docs/architecture.md").read_text(encoding="utf-8")
    rooms = {path.parent.name for path in (REPOSITORY / "scaleup").glob("*/__init__.py")}
    assert rooms <= set(re.findall(r"\*\*(\w+)\*\*", page))


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_in_docstrings(module, store):
    assert doctest.testmod(import_module(module)).failed == 0
