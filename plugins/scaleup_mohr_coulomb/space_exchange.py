"""The free surface in space moved by the flow, with the volume of powder that elements exchange."""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from .element_lattice import TIMES, WEIGHTS
from .element_matrix import ElementMatrix
from .element_shapes import ElementShapes
from .positive_system import PositiveSystem
from .shared_matrix import Numbering
from .space_level_set import EDGES, SpaceLevelSet
from .surface_kernels import positive_shares
from .surface_transport import Transport

# Part of the diagonal that fixes the potential's constant.
_TIE = 1e-9


def _quarters() -> NDArray[Any]:
    """Nodes (4 faces, 4 quarters, 3) of an element, the face k being opposite to its corner k."""
    middle = {edge: 4 + number for number, edge in enumerate(EDGES)}
    faces = []
    for opposite in range(4):
        a, b, c = (corner for corner in range(4) if corner != opposite)
        ab, ac, bc = middle[a, b], middle[a, c], middle[b, c]
        faces.append([(a, ab, ac), (b, ab, bc), (c, ac, bc), (ab, ac, bc)])
    return np.array(faces)


class FaceFluxes:
    """Fluxes (m^3/s) out of elements through quarters of their faces, balanced in every element.

    With F0 those of a velocity, they are the nearest that leave each element as much as they enter
    it, and do not pass the boundary:

        minimise  sum (F - F0)^2 / A    such that    sum_faces F = 0    in every element,

    over faces of area A.  F = F0 + A (mu_face - lambda_element); the lambda are eliminated element
    by element, so that their balances hold to round-off, and what the solver leaves of the mu is
    the difference between what leaves an element and what enters its neighbour.  Collective.
    """

    def __init__(self, level_set: SpaceLevelSet) -> None:
        mesh = level_set.mesh
        quarters = _quarters()
        self.nodes = level_set.elements[:, quarters]
        corner = level_set.nodes[self.nodes]
        normal = 0.5 * np.cross(
            corner[..., 1, :] - corner[..., 0, :], corner[..., 2, :] - corner[..., 0, :]
        )
        opposite = level_set.nodes[level_set.elements[:, :4]]
        outward = corner.mean(axis=(2, 3)) - opposite
        signs = np.sign(np.einsum("efqk,efk->efq", normal, outward))
        areas = np.linalg.norm(normal, axis=-1)
        self._areas = areas.sum(axis=2)
        self._parts = areas / self._areas[..., None]

        space = ngs.FacetFESpace(mesh, order=0)
        self._numbering = Numbering(space)
        self._faces = _element_faces(mesh)
        ends = np.bincount(self._faces.ravel(), minlength=space.ndof)
        inner = self._numbering.completed(ends)[self._faces] == 2.0
        self._normals = normal * (signs * inner[..., None])[..., None]
        self._matrix = ElementMatrix(self._faces, space.ndof)
        self._system = PositiveSystem(self._matrix.share, self._numbering, "hypre")
        self._potential = np.zeros(space.ndof)
        self.balance(np.ones(mesh.ne, dtype=bool))

    def balance(self, wanted: NDArray[Any]) -> None:
        """Balance elements ``wanted`` (flags), from now on; others give and take.  Collective."""
        self._per_area = np.where(wanted, 1.0 / self._areas.sum(axis=1), 0.0)
        a = self._areas
        self._matrix.blocks[:] = -a[:, :, None] * a[:, None, :] * self._per_area[:, None, None]
        face = np.arange(4)
        self._matrix.blocks[:, face, face] += (1.0 + _TIE) * a
        self._system.update()

    def of(self, velocity: NDArray[Any]) -> NDArray[Any]:
        """(n_elements, 4, 4) of a velocity with these values (n_nodes, 3) at the nodes."""
        mean = velocity[self.nodes].mean(axis=-2)
        quarters = (mean * self._normals).sum(axis=-1)
        flux = quarters.sum(axis=2)
        gain = (flux.sum(axis=1) * self._per_area)[:, None]
        load = np.bincount(
            self._faces.ravel(), (self._areas * gain - flux).ravel(), len(self._potential)
        )
        self._potential = self._system.solve(load, self._potential)
        mu = self._potential[self._faces]
        average = (self._areas * mu).sum(axis=1) * self._per_area
        change = self._areas * (mu - average[:, None] - gain)
        balanced: NDArray[Any] = quarters + self._parts * change[..., None]
        return balanced


def _element_faces(mesh: Any) -> NDArray[Any]:
    """Local numbers (n_elements, 4) of elements' faces, the face k opposite to corner k."""
    number = {frozenset(v.nr for v in face.vertices): face.nr for face in mesh.faces}
    found = []
    for element in mesh.Elements(ngs.VOL):
        corners = frozenset(v.nr for v in element.vertices)
        found.append([number[corners - {v.nr}] for v in element.vertices])
    return np.array(found, dtype=int).reshape(-1, 4)


class ExchangingTransport:
    """:class:`Transport` of a level set in space, and of the volume that elements exchange.

    After the step by a velocity vertices are shifted until each element holds

        V^{n+1} = V^n - dt int H(phi) u.n dA

    over its faces, u.n by :class:`FaceFluxes`: what leaves an element enters its neighbour, and
    nothing passes the wall.  Collective.
    """

    def __init__(
        self, level_set: SpaceLevelSet, velocity: Any, time_step: Any, shapes: ElementShapes
    ) -> None:
        """``velocity`` is a coefficient function, ``time_step`` an ngs.Parameter, s."""
        self._level_set, self._time_step = level_set, time_step
        self._transport = Transport(level_set, velocity, time_step, shapes)
        self.fluxes = FaceFluxes(level_set)

    def step(self, velocity: NDArray[Any]) -> None:
        """Replace phi^n by phi^{n+1}; ``velocity`` (n_nodes, 3) in m/s is that of mid-step."""
        level_set = self._level_set
        before = level_set.nodal(level_set.field.vec.FV().NumPy())
        held = level_set.element_volumes()
        self._transport.step()
        after = level_set.nodal(level_set.field.vec.FV().NumPy())
        fluxes = self.fluxes.of(velocity)
        both = np.concatenate([before[level_set.elements], after[level_set.elements]], axis=1)
        cut = (both.min(axis=1) <= 0.0) & (both.max(axis=1) > 0.0)
        outflow = np.zeros(len(held))
        nodes = self.fluxes.nodes[cut]
        for time, weight in zip(TIMES, WEIGHTS, strict=True):
            values = ((1.0 - time) * before + time * after)[nodes]
            shares = positive_shares(values.reshape(-1, 3)).reshape(values.shape[:-1])
            outflow[cut] += weight * (shares * fluxes[cut]).sum(axis=(1, 2))
        level_set.hold(held - self._time_step.Get() * outflow)
