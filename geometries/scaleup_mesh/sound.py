"""Triangles to the closed surface of a vessel's inside, or one sentence on why they are none.

1  vertices at equal places are joined; triangles that shrink to a line by that are dropped;
2  of triangles that are listed several times one is kept;
3  vertices on open edges are joined if they lie within the welding tolerance of each other;
4  every edge then lies between two triangles, that go round it in opposite directions;
5  no triangle cuts another one;
6  one of the surfaces that hang together encloses all others; these bound bodies inside of it;
7  what is enclosed is no wall (`thickness.is_wall`).
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import igl.predicates
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from scaleup.contract import FloatArray, InputError, IntArray
from scaleup_mesh.thickness import is_wall, mean_thickness

_MOST = 2_000_000  # triangles
_WELDED = 1e-5  # of the size: vertices on open edges closer than that are one
_FLAT = 1e-12  # area over the square of the size, below which a triangle has none
_BODIES = 100  # inside the vessel
_MM = 1e3


@dataclass(frozen=True)
class Sound:
    """A closed surface: vertices (v, 3) in m, triangles (n, 3) outwards, what was mended."""

    vertices: FloatArray
    faces: IntArray
    notes: tuple[str, ...]


class _Draft:
    """A surface in the making; lengths over the size of its box, which is `size` in m."""

    def __init__(self, where: str, vertices: FloatArray, faces: IntArray, scale: float):
        self.where, self.notes = where, list[str]()
        if len(faces) == 0 or len(vertices) == 0:
            raise InputError(f"{where}: holds no triangles")
        if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
            raise InputError(f"{where}: holds vertices that have not three coordinates each")
        if len(faces) > _MOST:
            raise InputError(
                f"{where}: {len(faces)} triangles are more than {_MOST}; take a coarser mesh"
            )
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError(f"{where}: triangles name vertices that are not there")
        used = np.unique(faces)
        vertices, faces = vertices[used], np.searchsorted(used, faces)
        if not np.isfinite(vertices).all():
            raise InputError(f"{where}: holds coordinates that are not finite")
        with np.errstate(over="ignore", under="ignore"):
            self._low = vertices.min(axis=0)
            extent = float((vertices.max(axis=0) - self._low).max())
            if not 1e-100 < extent < 1e100:
                raise InputError(f"{where}: is of size {extent:.3g}; no vessel is")
            self.vertices = (vertices - self._low) / extent
        self.faces, self.size, self._extent, self._scale = faces, extent * scale, extent, scale

    def refuse(self, text: str) -> None:
        raise InputError(f"{self.where}: {text}")

    def at(self, place: FloatArray) -> str:
        """A place as the file gives it."""
        return "({:.5g}, {:.5g}, {:.5g})".format(*(self._low + self._extent * place))

    def mm(self, length: float) -> str:
        return f"{_MM * self.size * length:.3g} mm"

    def finished(self) -> Sound:
        vertices = (self._low + self._extent * self.vertices) * self._scale
        faces = np.ascontiguousarray(self.faces, dtype=np.int64)
        return Sound(np.ascontiguousarray(vertices), faces, tuple(self.notes))


def sound_surface(
    where: str, vertices: FloatArray, faces: IntArray, scale: float, bound_cells: bool
) -> Sound:
    """The surface of triangles in the file's coordinates, of which one is `scale` m.

    where       -- the file's key and name, for sentences
    bound_cells -- whether volume cells say where the inside is, however the triangles go round
    Raises InputError.
    """
    draft = _Draft(where, vertices, faces, scale)
    joined, draft.faces = _joined(draft.vertices, draft.faces)
    draft.vertices = joined
    _refuse_flat(draft)
    _drop_repeated(draft)
    _weld(draft)
    _refuse_open(draft)
    if bound_cells:
        draft.faces = igl.bfs_orient(draft.faces)[0]
    _refuse_turned(draft)
    _refuse_cut(draft)
    _arrange(draft, bound_cells)
    if is_wall(draft.vertices, draft.faces):
        wall = draft.mm(mean_thickness(draft.vertices, draft.faces))
        draft.refuse(
            f"bounds a wall, about {wall} thick, not the inside of a vessel; give the surface that "
            "the powder touches, closed by a lid, or in CAD the solid that fills the vessel"
        )
    return draft.finished()


def _joined(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Vertices at equal places as one; without triangles that meet one of them twice."""
    vertices, number = np.unique(vertices, axis=0, return_inverse=True)
    return vertices, _without_lines(number.reshape(-1)[faces])


def _without_lines(faces: IntArray) -> IntArray:
    corners = np.sort(faces, axis=1)
    kept: IntArray = faces[(corners[:, :-1] != corners[:, 1:]).all(axis=1)]
    return kept


def _refuse_flat(draft: _Draft) -> None:
    corner = draft.vertices[draft.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    flat = 0.5 * np.linalg.norm(normal, axis=1) <= _FLAT
    if flat.all():
        draft.refuse("holds no triangles with an area")
    if flat.any():
        place = draft.at(corner[flat][0].mean(axis=0))
        draft.refuse(
            f"{flat.sum()} triangles are degenerate (no area), the first at {place}; repair the "
            "mesh"
        )


def _drop_repeated(draft: _Draft) -> None:
    """Keep one of triangles with the same corners, if they go round them in the same direction."""
    _, first, which, counts = np.unique(
        np.sort(draft.faces, axis=1),
        axis=0,
        return_index=True,
        return_inverse=True,
        return_counts=True,
    )
    if counts.max() == 1:
        return
    lead = np.argmin(draft.faces, axis=1)
    rolled = np.take_along_axis(draft.faces, (lead[:, None] + np.arange(3)) % 3, axis=1)
    opposite = (rolled != rolled[first[which.reshape(-1)]]).any(axis=1)
    if opposite.any():
        place = draft.at(draft.vertices[draft.faces[opposite][0]].mean(axis=0))
        draft.refuse(
            f"two triangles lie back to back at {place}; a part inside must have a thickness, and "
            "parts that touch must be united"
        )
    repeated = len(draft.faces) - len(first)
    draft.faces = draft.faces[np.sort(first)]
    draft.notes.append(f"{repeated} triangles that are listed more than once count once")


def _directed(faces: IntArray) -> IntArray:
    """The triangles' edges in the direction they are gone round, (3 n, 2), n by n."""
    return np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])


def _edges(faces: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Edges (e, 2), the lesser vertex first; how many triangles meet there; one's directed edge."""
    edges, first, counts = np.unique(
        np.sort(_directed(faces), axis=1), axis=0, return_index=True, return_counts=True
    )
    return edges, counts, first


def _weld(draft: _Draft) -> None:
    """Join vertices on open edges that lie within the tolerance of each other."""
    edges, counts, _ = _edges(draft.faces)
    loose = np.unique(edges[counts == 1])
    if not len(loose):
        return
    pairs = cKDTree(draft.vertices[loose]).query_pairs(_WELDED, output_type="ndarray")
    if not len(pairs):
        return
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(loose),) * 2)
    groups = connected_components(links, directed=False)[1]
    first = np.unique(groups, return_index=True)[1]
    moved = np.linalg.norm(draft.vertices[loose] - draft.vertices[loose[first[groups]]], axis=1)
    number = np.arange(len(draft.vertices))
    number[loose] = loose[first[groups]]
    draft.faces = _without_lines(number[draft.faces])
    if not len(draft.faces):
        draft.refuse("holds no triangles larger than the welding tolerance")
    draft.notes.append(
        f"gaps of up to {draft.mm(float(moved.max()))} were closed: vertices within "
        f"{draft.mm(_WELDED)} on open edges count as one"
    )
    _refuse_flat(draft)
    _drop_repeated(draft)


def _refuse_open(draft: _Draft) -> None:
    edges, counts, first = _edges(draft.faces)
    bad = counts != 2
    if not bad.any():
        return
    text = f"not watertight; {bad.sum()} edges do not lie between two triangles"
    if (counts == 1).any():
        rim = _directed(draft.faces)[first[counts == 1]]
        width, place = _widest_gap(draft.vertices, rim)
        if width > 0.1 * _WELDED:
            gap = f"the widest gap is about {draft.mm(width)} wide"
        else:
            gap = "a vertex lies within another triangle's edge"
        draft.refuse(f"{text}: {gap}, at {draft.at(place)} of the file; close the surface")
    place = draft.at(draft.vertices[edges[bad][0]].mean(axis=0))
    draft.refuse(
        f"{text} but between more of them, as at {place} of the file, where parts touch or a wall "
        "has no thickness; unite the parts"
    )


def _widest_gap(vertices: FloatArray, rim: IntArray) -> tuple[float, FloatArray]:
    """Width of the widest gap that open edges (e, 2) bound, four times its area over its rim.

    Its place is the vertex there that lies nearest to another one.
    """
    corners, number = np.unique(rim, return_inverse=True)
    ends = number.reshape(-1, 2)
    links = coo_array((np.ones(len(ends)), ends.T), shape=(len(corners),) * 2)
    gaps = connected_components(links, directed=False)[1]
    which, points = gaps[ends[:, 0]], vertices[corners]
    count = int(gaps.max()) + 1
    middle = np.stack([np.bincount(gaps, x, count) for x in points.T], axis=1)
    middle /= np.bincount(gaps, minlength=count)[:, None]
    start, end = (points[ends[:, side]] - middle[which] for side in range(2))
    area = np.stack([np.bincount(which, x, count) for x in 0.5 * np.cross(start, end).T], axis=1)
    length = np.bincount(which, np.linalg.norm(end - start, axis=1), count)
    width = 4.0 * np.linalg.norm(area, axis=1) / length
    widest = int(width.argmax())
    there = points[gaps == widest]
    nearest = cKDTree(there).query(there, k=2)[0][:, 1].argmin()
    return float(width[widest]), there[nearest]


def _refuse_turned(draft: _Draft) -> None:
    edges, counts = np.unique(_directed(draft.faces), axis=0, return_counts=True)
    if (counts > 1).any():
        place = draft.at(draft.vertices[edges[counts > 1][0]].mean(axis=0))
        draft.refuse(
            f"neighbouring triangles have opposite orientations, as at {place} of the file; orient "
            "the surface"
        )


def _refuse_cut(draft: _Draft) -> None:
    faces = np.ascontiguousarray(draft.faces, dtype=np.int64)
    vertices = np.ascontiguousarray(draft.vertices)
    cuts, pairs, _ = igl.predicates.find_self_intersections(vertices, faces, False)
    if cuts:
        place = draft.at(vertices[faces[pairs[0]]].mean(axis=(0, 1)))
        number = len(np.unique(pairs))
        draft.refuse(
            f"the surface passes through itself: {number} triangles cut others, as at {place} of "
            "the file; unite parts that overlap, or unfold it"
        )


def _arrange(draft: _Draft, bound_cells: bool) -> None:
    """Turn the surface of all outwards, those of bodies within it inwards."""
    bodies = _bodies(draft.faces)
    count = int(bodies.max()) + 1
    if count - 1 > _BODIES:
        draft.refuse(f"holds {count} separate surfaces, more than {_BODIES}")
    parts = [draft.faces[bodies == k] for k in range(count)]
    volumes = np.array([_volume(draft.vertices, part) for part in parts])
    within = np.zeros((count, count), dtype=bool)  # [inner, outer]
    for k, part in enumerate(parts):
        probes = np.array([draft.vertices[other[0, 0]] for other in parts])
        within[:, k] = np.abs(igl.winding_number(draft.vertices, part, probes)) > 0.5
        within[k, k] = False
    depth = within.sum(axis=1)
    separate = f"holds {count} separate surfaces"
    if (depth == 0).sum() != 1:
        draft.refuse(f"{separate}, side by side; give the inside of the vessel as one")
    if depth.max() > 1:
        draft.refuse(f"{separate}, within each other; give the inside of the vessel as one")
    signs = np.sign(volumes)
    outer = int(np.argmin(depth))
    if not bound_cells and (np.delete(signs, outer) == signs[outer]).any():
        draft.refuse(
            f"{separate}, one within the other and turned the same way, so that it is open which "
            "bounds the powder; give the inside of the vessel as one, a body within it turned "
            "inwards"
        )
    wanted = np.where(depth == 0, 1.0, -1.0)
    turned = (signs != wanted)[bodies]
    draft.faces = np.where(turned[:, None], draft.faces[:, ::-1], draft.faces)
    if count > 1:
        litres = 1e3 * draft.size**3 * float(np.abs(np.delete(volumes, outer)).sum())
        draft.notes.append(f"{count - 1} closed bodies of {litres:.3g} litres stand in the vessel")


def _bodies(faces: IntArray) -> NDArray[np.int32]:
    """The number of each triangle's surface: those that share an edge hang together."""
    edges = np.sort(_directed(faces), axis=1)
    which = np.unique(edges, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.argsort(which, kind="stable").reshape(-1, 2) % len(faces)
    links = coo_array((np.ones(len(order)), order.T), shape=(len(faces),) * 2)
    found: NDArray[np.int32] = connected_components(links, directed=False)[1]
    return found


def _volume(vertices: FloatArray, faces: IntArray) -> float:
    corner = vertices[faces]
    return float(np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0)
