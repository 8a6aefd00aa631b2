"""What a given error costs with the mixing backends, and with other libraries' transport.

    python benchmarks/other_libraries.py [--pyclaw-python PATH] [--errors 0.1 0.01 0.001]

A Gaussian (sigma 0.05) turns once in a round bed. Every code runs on a few grids, in this one run;
processor seconds of its time steps (set-up of matrices and stencils left out, that of
`semi-lagrangian`, its search for paths, included) at a given L1 error are read off the line through
its points (log over log), and divided by those of `finite-volume`. L1 is relative and that of the
means of the cells (of the triangles, with the discontinuous Galerkin method). Whether values lie in
[0, 1] is seen at the end (for the backends in every step); that and the drift of the mass are the
worst of all its runs.

NGSolve: discontinuous Galerkin with upwind fluxes on triangles, the operator as a sparse matrix
(the mass matrix is diagonal), the classical Runge-Kutta method at 0.9 of the longest stable step.
PyClaw (package `clawpack`): in the process of an interpreter that has it, since it needs a newer
numpy; its second-order scheme with the MC limiter, and SharpClaw's WENO of fifth order.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags

from scaleup.system import registry
from scaleup.verification import problems, run

CENTRE, SIGMA = (0.5, 0.75), 0.05  # of the verification problem `gaussian`
POWERS = 100
ROUND_OFF = 1e-9
STABLE = 2.5  # step times the greatest eigenvalue, of the Runge-Kutta method (2.6 to 2.8)


@dataclass
class Point:
    """A run: error, processor seconds, range of values at the end, relative change of the mass."""

    unknowns: int
    l1: float
    seconds: float
    minimum: float
    maximum: float
    drift: float


def ours(name: str, n: int, **options: Any) -> Point:
    """A mixing backend."""
    plugin = registry.load("mixing", name)
    r = run(problems()["gaussian"], plugin(plugin.Options(**options)), n)
    return Point(r.cells, r.l1, r.core_seconds, r.minimum, r.maximum, r.mass_drift)


def discontinuous_galerkin(order: int, n: int) -> Point:
    """NGSolve on triangles of about 1/n."""
    import ngsolve as ng
    from netgen.geom2d import SplineGeometry

    geometry = SplineGeometry()
    geometry.AddCircle((0.5, 0.5), 0.5)
    mesh = ng.Mesh(geometry.GenerateMesh(maxh=1.0 / n))
    space = ng.L2(mesh, order=order, dgjumps=True)
    u, v = space.TnT()
    wind = 2 * math.pi * ng.CoefficientFunction((0.5 - ng.y, ng.x - 0.5))
    across = ng.InnerProduct(wind, ng.specialcf.normal(2))
    upwind = ng.IfPos(across, u, u.Other(bnd=0.0))
    form = ng.BilinearForm(space)
    form += u * ng.InnerProduct(wind, ng.grad(v)) * ng.dx
    form += -across * upwind * v * ng.dx(element_boundary=True)
    form.Assemble()
    mass = matrix_of(ng.BilinearForm(u * v * ng.dx).Assemble())
    weights = mass.diagonal()
    assert abs(mass - diags(weights)).max() < 1e-10 * weights.max()
    operator = (diags(1.0 / weights) @ matrix_of(form)).tocsr()
    steps = math.ceil(greatest_eigenvalue(operator) / (0.9 * STABLE))
    exact = ng.exp(-((ng.x - CENTRE[0]) ** 2 + (ng.y - CENTRE[1]) ** 2) / (2 * SIGMA**2))
    field = ng.GridFunction(space)
    field.Set(exact)
    held = ng.Integrate(field, mesh)
    c, dt = field.vec.FV().NumPy().copy(), 1.0 / steps
    began = time.process_time()
    for _ in range(steps):
        k1 = operator @ c
        k2 = operator @ (c + 0.5 * dt * k1)
        k3 = operator @ (c + 0.5 * dt * k2)
        c += dt / 6.0 * (k1 + 2.0 * (k2 + k3) + operator @ (c + dt * k3))
    seconds = time.process_time() - began
    field.vec.FV().NumPy()[:] = c
    points = mesh(*(0.2 + 0.6 * np.random.default_rng(1).random((2, 20_000))))
    values = field(points)
    of_triangles = partial(ng.Integrate, mesh=mesh, order=2 * order + 4, element_wise=True)
    off = np.abs(np.array(of_triangles(field - exact))).sum()
    return Point(
        space.ndof,
        float(off / np.array(of_triangles(exact)).sum()),
        seconds,
        float(values.min()),
        float(values.max()),
        ng.Integrate(field, mesh) / held - 1.0,
    )


def matrix_of(form: Any) -> Any:
    """Sparse matrix of a form of NGSolve."""
    values, columns, rows = form.mat.CSR()
    found = csr_matrix((np.array(values), np.array(columns), np.array(rows)))
    found.eliminate_zeros()
    return found


def greatest_eigenvalue(matrix: Any) -> float:
    """Its size, by what the matrix makes of a vector in the end."""
    vector = np.random.default_rng(2).normal(size=matrix.shape[0])
    growth = []
    for _ in range(POWERS):
        vector = matrix @ (vector / np.linalg.norm(vector))
        growth.append(np.linalg.norm(vector))
    return float(np.exp(np.log(growth[POWERS // 2 :]).mean()))


PYCLAW = """
import json, sys, time
import numpy as np
from clawpack import pyclaw, riemann

kind, n = sys.argv[1], int(sys.argv[2])
nodes, weights = np.polynomial.legendre.leggauss(3)
edges = np.linspace(0.0, 1.0, n + 1)
middles = 0.5 * (edges[1:] + edges[:-1])

def mean(centre):
    at = middles[:, None] + 0.5 / n * nodes
    return (np.exp(-((at - centre) ** 2) / (2 * 0.05**2)) * 0.5 * weights).sum(axis=1)

if kind == "mc":
    solver = pyclaw.ClawSolver2D(riemann.vc_advection_2D)
    solver.limiters = pyclaw.limiters.tvd.MC
    solver.dimensional_split = True
    solver.cfl_max, solver.cfl_desired = 1.0, 0.9
else:
    solver = pyclaw.SharpClawSolver2D(riemann.vc_advection_2D)
    solver.weno_order = 5
for bounds in (solver.bc_lower, solver.bc_upper, solver.aux_bc_lower, solver.aux_bc_upper):
    bounds[0] = bounds[1] = pyclaw.BC.extrap
domain = pyclaw.Domain([0.0, 0.0], [1.0, 1.0], [n, n])
state = pyclaw.State(domain, 1, num_aux=2)
state.aux[0] = 2 * np.pi * (0.5 - middles)[None, :]
state.aux[1] = 2 * np.pi * (middles - 0.5)[:, None]
exact = np.outer(mean(0.5), mean(0.75))
state.q[0] = exact
control = pyclaw.Controller()
control.solution, control.solver = pyclaw.Solution(state, domain), solver
control.tfinal, control.num_output_times, control.output_format = 1.0, 1, None
control.keep_copy, control.verbosity = False, 0
solver.dt_initial = 0.1 / (2 * np.pi * n)
solver.max_steps = 10**6
began = time.process_time()
control.run()
seconds = time.process_time() - began
q = control.solution.state.q[0]
print(json.dumps([n * n, abs(q - exact).sum() / exact.sum(), seconds, q.min(), q.max(),
                  q.sum() / exact.sum() - 1.0]))
"""


def pyclaw(interpreter: str, kind: str, n: int) -> Point:
    """PyClaw on n x n cells of the unit square, in a process of an interpreter that has it."""
    found = subprocess.run(
        [interpreter, "-c", PYCLAW, kind, str(n)], check=True, capture_output=True, text=True
    )
    return Point(*json.loads(found.stdout.splitlines()[-1]))


def cost_at(error: float, points: list[Point]) -> float:
    """Processor seconds at an L1 error, between the runs (log over log); nan beyond them."""
    by_error = sorted(points, key=lambda point: point.l1)
    errors = np.log([point.l1 for point in by_error])
    if not errors[0] <= math.log(error) <= errors[-1]:
        return math.nan
    seconds = np.log([point.seconds for point in by_error])
    return float(np.exp(np.interp(math.log(error), errors, seconds)))


def at_work(only: str) -> dict[str, tuple[Callable[[int], Point], tuple[int, ...]]]:
    """Label -> (run at a size, sizes); `only` is an interpreter with PyClaw, or empty."""
    found: dict[str, tuple[Callable[[int], Point], tuple[int, ...]]] = {
        "finite-volume": (partial(ours, "finite-volume"), (24, 32, 48, 64, 96, 128, 192)),
        "semi-lagrangian": (partial(ours, "semi-lagrangian"), (16, 24, 32, 48, 64, 96, 128)),
        "implicit-fem": (partial(ours, "implicit-fem"), (32, 48, 64, 96, 128, 160)),
        "lax-wendroff (flux-corrected)": (
            partial(ours, "lax-wendroff", form="flux-corrected"),
            (64, 128, 256, 384, 512),
        ),
        "NGSolve DG, order 3": (partial(discontinuous_galerkin, 3), (6, 8, 12, 16, 24, 32)),
        "NGSolve DG, order 4": (partial(discontinuous_galerkin, 4), (5, 6, 8, 12, 16, 24)),
    }  # fmt: skip
    if only:
        found["PyClaw, MC limiter"] = (partial(pyclaw, only, "mc"), (64, 128, 256, 512))
        found["SharpClaw, WENO5"] = (partial(pyclaw, only, "weno"), (32, 48, 64, 96, 128, 192))
    return found


def table(curves: dict[str, list[Point]], errors: list[float]) -> list[str]:
    """Lines of a Markdown table; empty where no run was so exact or so coarse."""
    heads = "".join(f" s at L1 {error:g} | times |" for error in errors)
    lines = [f"| method |{heads} in [0, 1] | mass drift |", "|---" * (3 + 2 * len(errors)) + "|"]
    for label, points in curves.items():
        line = f"| {label} |"
        for error in errors:
            cost = cost_at(error, points)
            ratio = cost / cost_at(error, curves["finite-volume"])
            known = f" {cost:.2g} | {ratio:.{1 if ratio > 2 else 2}f} |"
            line += " | |" if math.isnan(ratio) else known
        outside = max(max(-point.minimum, point.maximum - 1.0) for point in points)
        bounded = "yes" if outside < ROUND_OFF else f"by {outside:.0e}"
        drift = max(abs(point.drift) for point in points)
        lines.append(f"{line} {bounded} | {drift:.0e} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--pyclaw-python", default="", help="interpreter in whose environment `clawpack` is"
    )
    parser.add_argument("--errors", type=float, nargs="+", default=[0.1, 0.01, 0.001])
    arguments = parser.parse_args()
    curves: dict[str, list[Point]] = {}
    for label, (measure, sizes) in at_work(arguments.pyclaw_python).items():
        curves[label] = [measure(n) for n in sizes]
        for n, point in zip(sizes, curves[label], strict=True):
            print(f"{label:30s} {n:4d} {point}", file=sys.stderr, flush=True)
    print("\n".join(table(curves, arguments.errors)))
    if not arguments.pyclaw_python:
        print("\nPyClaw is not measured: no interpreter was given by --pyclaw-python.")


if __name__ == "__main__":
    main()
