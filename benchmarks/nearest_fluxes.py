"""Solvers of nearest fluxes on the problems of the flows and backends that ask for them.

Each problem is what a small run hands to `nearest_fluxes` (and `fit_stream_function`); every solver
then gets it in turn. Minutes, most of them for the flows.
"""

import time
from contextlib import contextmanager

import numpy as np
from mpi4py import MPI
from scipy.sparse.linalg import splu

from scaleup.case.composing import compose
from scaleup.flow.nearest_fluxes import Faces, laplacian, multigrid, nearest_fluxes
from scaleup.flow.source import obtain_flow
from scaleup.flow.stream_function import fit_stream_function
from scaleup.run.blending import mix
from scaleup_mohr_coulomb import closing, on_grid, space_exchange
from scaleup_semi_lagrangian import settlement
from scaleup_surface_layer import continuity

ROUNDS, KEPT, EVERY = 3, 3, 10
problems: dict[str, list] = {}


def listen(module, name):
    """Keep some of the problems that a module hands to `nearest_fluxes`."""
    calls = 0

    def kept(faces, given, weight, outflow, solver, rest):
        nonlocal calls
        calls += 1
        found = problems.setdefault(name, [])
        if calls % EVERY == 0 and len(found) < KEPT:
            found.append((faces, given.copy(), weight.copy(), outflow.copy(), solver, rest))
        return nearest_fluxes(faces, given, weight, outflow, solver, rest)

    module.nearest_fluxes = kept


@contextmanager
def direct(faces, weight):
    """A sparse factorisation."""
    n = faces.count
    ends = np.bincount(faces.lower, weight, n) + np.bincount(faces.upper, weight, n)
    ends[faces.tree.roots] = 2.0 * ends[faces.tree.roots] + (ends[faces.tree.roots] == 0)
    matrix = laplacian(ends, faces.lower, faces.upper, weight).tocsc()
    yield splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve


def plane(grid, inside, wet, flux):
    """The problem of a stream function, with its cells in place of corners."""
    held = [np.pad(w > 0, 1) for w in wet]
    number = np.full((grid.counts[1] + 2, grid.counts[0] + 2), -1)
    any_wet = held[0][1:-1, 1:-2] | held[0][1:-1, 2:-1] | held[1][1:-2, 1:-1] | held[1][2:-1, 1:-1]
    number[1:-1, 1:-1][any_wet] = np.arange(any_wet.sum())
    sides = (number[1:-1, :-1], number[1:-1, 1:]), (number[:-1, 1:-1], number[1:, 1:-1])
    lower, upper = (np.concatenate([s[k].ravel() for s in sides]) for k in (0, 1))
    weight, given = (np.concatenate([v.ravel() for v in values]) for values in (wet, flux))
    here = (lower >= 0) & (upper >= 0) & (weight > 0)
    faces = Faces(int(any_wet.sum()), lower[here], upper[here])
    zero = np.zeros(faces.count)
    return faces, given[here], weight[here] / weight.max(), zero, multigrid(1e-10), "again"


def elements(fluxes, velocity):
    """The problem of the volume that finite elements exchange; those not balanced are one cell."""
    sides = (velocity[fluxes.nodes].mean(axis=-2) * fluxes._normals).sum(axis=(-1, 2)).ravel()
    numbers, areas = fluxes._faces.ravel(), fluxes._areas.ravel()
    order = np.argsort(numbers, kind="stable")
    first = np.flatnonzero(numbers[order][1:] == numbers[order][:-1])
    one, other = order[first], order[first + 1]
    count = len(fluxes._per_area)
    cell = np.where(fluxes._per_area > 0, np.arange(count), count)
    lower, upper = cell[one // 4], cell[other // 4]
    apart = lower != upper
    faces = Faces(count + 1, lower[apart], upper[apart])
    weight = areas[one][apart] / areas.max()
    return faces, sides[one][apart], weight, np.zeros(count + 1), multigrid(1e-8, "hypre"), "again"


def timed(work):
    """Least seconds of some rounds, and what the work returns."""
    spans = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        result = work()
        spans.append(time.perf_counter() - begin)
    return min(spans), result


def report(name):
    for faces, given, weight, outflow, own, rest in problems[name]:
        exact, _ = nearest_fluxes(faces, given, weight, outflow, multigrid(1e-14, "hypre"), "again")
        need = faces.missing(outflow, given)
        scale = np.abs(exact - given).max() or 1.0
        solvers = {"its own": own, "direct": direct}
        for kind in ("gamg", "hypre"):
            solvers |= {f"{kind} {t:g}": multigrid(t, kind) for t in (1e-4, 1e-8, 1e-12)}
        print(f"{name}: {faces.count} cells, {len(weight)} faces", flush=True)
        for title, solver in solvers.items():
            if title == "direct" and faces.count > 60_000:
                continue
            given_to = faces, given, weight, outflow, solver, rest
            seconds, (flux, potential) = timed(lambda given_to=given_to: nearest_fluxes(*given_to))
            change = weight * (potential[faces.lower] - potential[faces.upper])
            left = np.linalg.norm(faces.missing(need, change)) / np.linalg.norm(need)
            missing = np.abs(faces.missing(outflow, flux)).max() / np.abs(flux).max(initial=1e-300)
            off = np.abs(flux - exact).max() / scale
            print(f"  {title:12s} {seconds:8.3f} s  left {left:7.1e}  off {off:7.1e}  "
                  f"divergence {missing:7.1e}", flush=True)  # fmt: skip


def flows(settings, geometry, flow, **tables):
    case = compose(None, settings, {"geometry": {"name": geometry}, "flow": {"name": flow}})
    outcome = obtain_flow(case.changed(**tables) if tables else case, MPI.COMM_SELF)
    return case, outcome.flow


if __name__ == "__main__":
    listen(continuity, "layer's segments")
    case, flow = flows(["grid.cells=60000", "operation.revolutions=0.1", "accuracy.estimate=false",
                        "mixing.name=semi-lagrangian"], "v-blender", "surface-layer")  # fmt: skip
    EVERY = 4
    listen(settlement, "settling")
    mix(case, flow, MPI.COMM_SELF)
    report("layer's segments")
    report("settling")

    def stream(grid, inside, wet, flux):
        problems["stream function"] = [plane(grid, inside, wet, flux)]
        seconds, psi = timed(lambda: fit_stream_function(grid, inside, wet, flux))
        print(f"stream function by corners: {inside.sum()} of them, {seconds:.3f} s", flush=True)
        return psi

    on_grid.fit_stream_function = stream
    listen(closing, "closing in a plane")
    coarse = ["flow.fine_size='5 mm'", "flow.angle_tolerance='1 deg'", "flow.start_up=true",
              "flow.velocity_tolerance=0.2", "grid.spacing='0.6 mm'"]  # fmt: skip
    flows(coarse, "drum", "mohr-coulomb")
    report("stream function")
    report("closing in a plane")
    EVERY = 10
    listen(closing, "closing in space")
    exchange, seconds = space_exchange.FaceFluxes.of, []

    def of(fluxes, velocity):
        begin = time.perf_counter()
        found = exchange(fluxes, velocity)
        seconds.append(time.perf_counter() - begin)
        problems["elements"] = [elements(fluxes, velocity)]
        return found

    space_exchange.FaceFluxes.of = of
    few = ["flow.fine_size='30 mm'", "flow.intervals=24", "grid.cells=20000"]
    flows(few, "v-blender", "mohr-coulomb")
    report("closing in space")
    print(f"exchange by faces: {np.median(seconds):.4f} s, median of {len(seconds)}", flush=True)
    report("elements")
