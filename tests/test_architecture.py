"""Data flows one way, and imports follow it; checked on the syntax trees."""

import ast
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]

# Each module of scaleup may import those on lower floors only.
FLOORS = [
    {"errors", "ledger", "processes", "source_hash", "__init__"},
    {"files", "stopping"},
    {"grid", "units", "launch", "registry", "hdf5", "run_lock"},
    {"blame"},
    {"spread", "cut_kernel", "merged_cells", "flux_kernels", "symmetric_solve"},
    {"cut_cells", "closed_surface"},
    {"flow_field", "scene", "parallel", "crew", "decomposition", "progress", "loading_file"},
    {
        "stream_function",
        "output_folder",
        "vessel_shape",
        "sample_flows",
        "conservative_bed",
        "compact_intervals",
        "bed_lean",
    },
    {"march", "flux_correction", "step_guard", "flow_check", "mixing_check"},
    {"explicit_transport", "bed_support"},
    {"api", "loading", "diffusion_tensor", "metrics", "feasibility"},
    {"ray_kernel"},
    {"testing", "config", "storage", "figures", "verification", "skeleton", "bed_view"},
    {"results", "bed_figures", "costs", "sampling", "resumption"},
    {"flow_source", "blending", "doctor", "stability_map", "cautions"},
    {"report", "plugin_check", "comparison", "planner"},
    {"pipeline"},
    {"cli"},
    {"__main__"},
]
# The same within a package that has a floor of its own.
FLOORS_WITHIN = {
    "verification": [
        {"problem"},
        {"bodies", "closed_flows", "fields", "sheared_disc"},
        {"rotations", "deformations", "spreading", "moving_fill", "drum_layer"},
        {"random_walk"},
        {"blending_drum"},
        {"problems", "study"},
        {"__init__"},
    ],
}
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


MODULES = sorted((REPOSITORY / "scaleup").rglob("*.py"))


def name_of(path: Path) -> str:
    return str(path.relative_to(REPOSITORY / "scaleup"))


PLUGINS = sorted(
    path for folder in ("plugins", "geometries") for path in (REPOSITORY / folder).rglob("*.py")
)


def place(path: Path) -> tuple[str, str]:
    """(package within scaleup, or its own name; name within that package, or "")."""
    parts = path.relative_to(REPOSITORY / "scaleup").with_suffix("").parts
    return parts[0], "/".join(parts[1:])


def floor(floors: list[set[str]], name: str) -> int:
    return next(level for level, names in enumerate(floors) if name in names)


def test_every_module_has_a_floor():
    assert {place(path)[0] for path in MODULES} == set().union(*FLOORS)
    for package, floors in FLOORS_WITHIN.items():
        within = {name for top, name in map(place, MODULES) if top == package}
        assert within == set().union(*floors)


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_go_downwards(path):
    top, name = place(path)
    own = [i.split(".")[1:] for i in runtime_imports(path) if i.startswith("scaleup.")]
    tops = {place(path)[0] for path in MODULES}
    for other, *inside in own:
        if other == top and name:
            floors = FLOORS_WITHIN[top]
            if inside and inside[0] in set().union(*floors):
                assert floor(floors, inside[0]) < floor(floors, name), inside
        elif other in tops:
            assert floor(FLOORS, other) < floor(FLOORS, top), other


@pytest.mark.parametrize("path", MODULES, ids=name_of)
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
