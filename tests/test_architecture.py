"""Data flows one way, and imports follow it; checked on the syntax trees."""

import ast
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]

# Each module of scaleup may import those on lower floors only.
FLOORS = [
    {"errors", "files", "__init__"},
    {"grid", "units", "launch"},
    {"spread", "cut_kernel"},
    {"cut_cells"},
    {"flow_field", "scene", "parallel", "decomposition", "progress"},
    {"stream_function", "registry", "output_folder", "vessel_shape", "compact_intervals"},
    {"api", "loading", "diffusion_tensor", "metrics"},
    {"testing", "config", "storage", "figures"},
    {"flow_source", "blending", "doctor"},
    {"report"},
    {"pipeline"},
    {"cli"},
    {"__main__"},
]
HEAVY = {"mpi4py", "petsc4py", "ngsolve", "netgen"}


def imports(path: Path, at_top_only: bool = False) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = tree.body if at_top_only else list(ast.walk(tree))
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            if node.level:
                found.add("." * node.level + node.module)
            else:
                found |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return found


def runtime_imports(path: Path) -> set[str]:
    """Imports but those under `if TYPE_CHECKING`."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    tree.body = [
        node
        for node in tree.body
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    ]
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


MODULES = sorted((REPOSITORY / "scaleup").glob("*.py"))
PLUGINS = sorted(
    path for folder in ("plugins", "geometries") for path in (REPOSITORY / folder).rglob("*.py")
)


def floor(name: str) -> int:
    return next(level for level, names in enumerate(FLOORS) if name in names)


def test_every_module_has_a_floor():
    assert {path.stem for path in MODULES} == set().union(*FLOORS)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.stem)
def test_imports_go_downwards(path):
    names = {path.stem for path in MODULES}
    own = {i.split(".")[1] for i in runtime_imports(path) if i.startswith("scaleup.")} & names
    above = {name for name in own if floor(name) >= floor(path.stem)}
    assert above == set()


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.stem)
def test_scaleup_knows_no_plugin_and_no_flow_solver(path):
    top = {name.split(".")[0] for name in imports(path)}
    assert not {name for name in top if name.startswith("scaleup_")}
    assert not top & {"ngsolve", "netgen"}


@pytest.mark.parametrize("path", PLUGINS, ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_plugins_see_only_the_api(path):
    own = path.relative_to(REPOSITORY).parts[1]
    for name in imports(path):
        package = name.split(".")[0]
        assert package != "scaleup" or name == "scaleup" or name.startswith("scaleup.api"), name
        assert not package.startswith("scaleup_") or package == own, name


@pytest.mark.parametrize(
    "path",
    [p for p in MODULES if p.stem in ("cli", "config", "registry", "launch", "api", "scene")]
    + [p for p in PLUGINS if p.stem == "__init__"],
    ids=lambda p: f"{p.parent.name}/{p.stem}",
)
def test_what_runs_before_the_launch_does_not_start_mpi(path):
    assert not {name.split(".")[0] for name in imports(path, at_top_only=True)} & HEAVY
