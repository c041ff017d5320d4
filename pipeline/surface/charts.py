"""Cutting a surface into few flat charts.

A mesh from photos is lumpy, and a cutter that follows its triangles' own normals makes a chart of
every lump. Here triangles are gathered by normals that have been evened over their neighbourhood
(Cohen-Steiner, Alliez, Desbrun, "Variational Shape Approximation", SIGGRAPH 2004: regions grow from
seeds, cheapest triangle first; seeds are then moved to the best triangle of their region), and
each chart is laid flat on the plane of its mean normal. Folds are straightened by letting inner
vertices relax (Tutte, "How to draw a graph", 1963). A chart that still overlaps itself is cut in
two.

Letters: n normals; u, v coordinates on a chart's plane, in the mesh's units.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from pipeline.geometry.mesh_io import unit
from pipeline.surface.raster import rasterize

EVENING = 12  # times that each triangle's normal is averaged with its neighbours'
CONE = 0.5  # smallest cosine between a triangle's evened normal and its chart's
ROUNDS = 4  # of growing regions and moving their seeds
FEWEST = 30  # triangles of a chart; smaller ones join a neighbour
OVERLAP_GRID = 192  # texels along a side of the picture in which overlaps are looked for
PAGE = 1024  # texels along a page on which no chart may overlap itself
NEIGHBOURS = 3  # that a chart is tried to be joined with
SQUEEZED = 0.25  # ratio below which no more than 2 % of a chart may be laid
FOLD = 5e-3  # smallest ratio of a triangle's area laid flat to its true one


@dataclass(frozen=True)
class FlatChart:
    """members: (m,) triangles of the mesh; index: (k,) its vertices; uv: (k, 2), in the mesh's
    units.
    """

    members: np.ndarray
    index: np.ndarray
    uv: np.ndarray


def adjacency(faces: np.ndarray) -> np.ndarray:
    """The triangle across each edge (m, 3), -1 at a border. Edge k joins corners k and k + 1; of an
    edge that more than two triangles share, only one pair is linked.
    """
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], -1).reshape(-1, 2)
    edges = np.sort(edges, axis=1)
    order = np.lexsort(edges.T)
    same = (edges[order[1:]] == edges[order[:-1]]).all(1)
    same[1:] &= ~same[:-1]
    out = np.full(len(edges), -1)
    first = order[:-1][same]
    second = order[1:][same]
    out[first] = second // 3
    out[second] = first // 3
    return out.reshape(-1, 3)


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (m, 3) and areas (m,)."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    return unit(cross), 0.5 * np.linalg.norm(cross, axis=1)


def evened(normals: np.ndarray, area: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Normals (m, 3) averaged with their neighbours' by area, EVENING times."""
    linked = (near >= 0)[..., None] * area[np.maximum(near, 0)][..., None]
    for _ in range(EVENING):
        total = area[:, None] * normals + (linked * normals[near]).sum(1)
        normals = unit(total)
    return normals


def cut(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The chart of each triangle (m,), numbered from 0; charts are connected."""
    near = adjacency(faces)
    own, area = face_normals(vertices, faces)
    normals = evened(own, area, near)
    middle = vertices[faces].mean(1)
    reach = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    chart = _grown(near, normals, area, middle, reach, CONE, ROUNDS)
    return _merged(chart, near, normals, area, FEWEST)


@njit(cache=True)
def _grow(
    chart: np.ndarray,
    start: int,
    seeds: np.ndarray,
    axes: np.ndarray,
    near: np.ndarray,
    normals: np.ndarray,
    middle: np.ndarray,
    reach: float,
    cone: float,
) -> None:
    """Fill what is -1 in `chart` from the seeds, cheapest triangle first, as far as the cone
    allows. Charts are numbered from `start`.
    """
    queue = [(0.0, seeds[k], k) for k in range(len(seeds))]
    while len(queue) > 0:
        _, face, k = heapq.heappop(queue)
        if chart[face] >= 0:
            continue
        chart[face] = start + k
        for side in range(3):
            other = near[face, side]
            if other < 0 or chart[other] >= 0:
                continue
            cosine = (normals[other] * axes[k]).sum()
            if cosine > cone:
                distance = np.sqrt(((middle[other] - middle[seeds[k]]) ** 2).sum())
                heapq.heappush(queue, (1 - cosine + distance / reach, other, k))


@njit(cache=True)
def _grown(
    near: np.ndarray,
    normals: np.ndarray,
    area: np.ndarray,
    middle: np.ndarray,
    reach: float,
    cone: float,
    rounds: int,
) -> np.ndarray:
    """Charts by growing alone: rounds of all seeds at once, and a new seed where none has reached.
    Seeds then move to the triangle nearest to their chart's mean normal.
    """
    count = len(near)
    chart = np.full(count, -1)
    seeds = np.empty(count, np.int64)
    axes = np.empty((count, 3))
    used = 0
    for _ in range(rounds):
        chart[:] = -1
        _grow(chart, 0, seeds[:used], axes[:used], near, normals, middle, reach, cone)
        for face in range(count):
            if chart[face] < 0:
                seeds[used] = face
                axes[used] = normals[face]
                new = slice(used, used + 1)
                _grow(chart, used, seeds[new], axes[new], near, normals, middle, reach, cone)
                used += 1

        means = np.zeros((used, 3))
        for face in range(count):
            means[chart[face]] += area[face] * normals[face]
        best = np.full(used, -2.0)
        for face in range(count):
            k = chart[face]
            cosine = (normals[face] * means[k]).sum()
            if cosine > best[k] or best[k] == -2.0:
                best[k] = cosine
                seeds[k] = face
        for k in range(used):
            length = np.sqrt((means[k] ** 2).sum())
            if length > 0:
                axes[k] = means[k] / length
    return chart


def _merged(
    chart: np.ndarray, near: np.ndarray, normals: np.ndarray, area: np.ndarray, fewest: int
) -> np.ndarray:
    """Charts smaller than `fewest` triangles given to the neighbour with the longest common border,
    of those that face the same side; numbered anew.
    """
    for _ in range(4):
        chart = np.unique(chart, return_inverse=True)[1]
        size = np.bincount(chart)
        axes = np.zeros((len(size), 3))
        np.add.at(axes, chart, area[:, None] * normals)
        axes = unit(axes)

        face, side = np.nonzero(near >= 0)
        one = chart[face]
        other = chart[near[face, side]]
        border = (one != other) & (size[one] < fewest) & ((axes[one] * axes[other]).sum(1) > 0)
        pairs, length = np.unique(np.stack([one, other])[:, border], axis=1, return_counts=True)
        if not len(length):
            break
        into = np.arange(len(size))
        for k in np.argsort(length):  # the longest comes last and stays
            small, large = pairs[:, k]
            into[small] = large
        larger = size[into] > size  # two small ones do not swap
        chart = np.where(larger, into, np.arange(len(size)))[chart]
    return np.unique(chart, return_inverse=True)[1]


def flattened(vertices: np.ndarray, faces: np.ndarray, chart: np.ndarray) -> list[FlatChart]:
    """Every chart laid flat: cut further where it overlaps itself, then joined with a neighbour
    where the two lie flat together. What still overlaps itself on texels half as large as a page's
    is cut once more, and its parts are joined with other neighbours.
    """
    order = np.argsort(chart, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(chart))[:-1])
    flat = laid_flat(vertices, faces, groups, OVERLAP_GRID)
    flat = joined_charts(vertices, faces, flat, range(len(flat)), OVERLAP_GRID)

    texel = np.sqrt(face_normals(vertices, faces)[1].sum()) / PAGE
    whole, parts = [], []
    for one in flat:
        corner = np.searchsorted(one.index, faces[one.members])
        texels = 2 * float(np.ptp(one.uv, axis=0).max()) / max(texel, 1e-30)
        grid = int(np.clip(texels, OVERLAP_GRID, 2 * PAGE))
        if len(corner) == 1 or not _overlaps(one.uv, corner, grid):
            whole.append(one)
        else:
            parts.extend(cut_again(vertices, faces, one))
    return joined_charts(vertices, faces, parts + whole, range(len(parts)), 2 * PAGE)


def cut_again(vertices: np.ndarray, faces: np.ndarray, chart: FlatChart) -> list[FlatChart]:
    """A chart in two or more, none of which overlaps itself on texels half as large as a page's."""
    halves = _halves(vertices, faces[chart.members], chart.members)
    return laid_flat(vertices, faces, halves, 2 * PAGE)


def laid_flat(
    vertices: np.ndarray, faces: np.ndarray, groups: list[np.ndarray], grid: int
) -> list[FlatChart]:
    """Groups of triangles laid flat, cut further where they overlap themselves on a grid."""
    waiting = list(groups)
    out = []
    while waiting:
        members = waiting.pop()
        flat = _flat(vertices, faces[members], grid)
        if flat is not None:
            out.append(FlatChart(members, *flat))
        else:
            waiting.extend(_halves(vertices, faces[members], members))
    return out


def joined_charts(
    vertices: np.ndarray, faces: np.ndarray, flat: list[FlatChart], which: range, grid: int
) -> list[FlatChart]:
    """The charts; those of the numbers `which`, smallest first, and what they become part of, are
    each joined with the neighbour of the longest common border with which they lie flat on a grid.
    """
    near = adjacency(faces)
    chart = np.empty(len(faces), int)
    for k, one in enumerate(flat):
        chart[one.members] = k
    kept: dict[int, FlatChart] = dict(enumerate(flat))
    queue = [(len(flat[k].members), k) for k in which]
    heapq.heapify(queue)
    while queue:
        size, k = heapq.heappop(queue)
        if k not in kept or len(kept[k].members) != size:
            continue
        beside = near[kept[k].members]
        others, border = np.unique(chart[beside[beside >= 0]], return_counts=True)
        ranked = others[np.argsort(-border)]
        for other in ranked[ranked != k][:NEIGHBOURS]:
            both = np.concatenate([kept[k].members, kept[int(other)].members])
            together = _flat(vertices, faces[both], grid)
            if together is not None:
                kept[int(other)] = FlatChart(both, *together)
                chart[kept.pop(k).members] = other
                heapq.heappush(queue, (len(both), int(other)))
                break
    return list(kept.values())


def _flat(
    vertices: np.ndarray, faces: np.ndarray, grid: int = OVERLAP_GRID
) -> tuple[np.ndarray, np.ndarray] | None:
    """Indices of a chart's vertices (k,) and their u, v (k, 2), scaled to the chart's true area;
    None where neither its projection nor the relaxed one lies flat without overlap.
    """
    index, corner = np.unique(faces, return_inverse=True)
    corner = corner.reshape(-1, 3)
    normals, area = face_normals(vertices, faces)
    axis = unit((area[:, None] * normals).sum(0)[None])[0]
    if not np.any(axis):
        axis = normals[0]
    side = unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])[None])[0]
    uv = (vertices[index] - vertices[index[0]]) @ np.stack([side, np.cross(axis, side)], -1)
    for rounds in (None, 0, 6, 30):
        attempt = uv if rounds is None else _relaxed(uv, corner, rounds)
        if attempt is None:
            return None
        if _lies_flat(attempt, corner, area, grid):
            laid = triangle_areas(attempt, corner).sum()
            return index, attempt * np.sqrt(area.sum() / max(laid, 1e-30))
    return None


def triangle_areas(uv: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Signed areas (m,) of triangles laid flat."""
    a, b, c = (uv[corner[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _lies_flat(uv: np.ndarray, corner: np.ndarray, area: np.ndarray, grid: int) -> bool:
    """Whether no triangle is folded over and none lies over another on a grid."""
    laid = triangle_areas(uv, corner)
    laid *= area.sum() / max(laid.sum(), 1e-30)
    if (laid < FOLD * area).any() or area[laid < SQUEEZED * area].sum() > 0.02 * area.sum():
        return False
    grids = sorted({OVERLAP_GRID, grid})  # the coarser one says no for less
    return len(corner) == 1 or not any(_overlaps(uv, corner, side) for side in grids)


def _overlaps(uv: np.ndarray, corner: np.ndarray, grid: int) -> bool:
    """Whether two triangles cover the same cell's centre of grid x grid over the chart's box."""
    span = max(float(np.ptp(uv, axis=0).max()), 1e-30)
    return bool((rasterize((uv - uv.min(0)) / (1.001 * span), corner, grid) > 1).any())


def _relaxed(uv: np.ndarray, corner: np.ndarray, rounds: int) -> np.ndarray | None:
    """u, v (k, 2) with every inner vertex in the middle of its neighbours, after each vertex of the
    border has been moved half-way to its two neighbours' middle `rounds` times. None where a part
    is closed: no border holds it, and its equations are singular.
    """
    count = len(uv)
    one = corner.ravel()
    other = np.roll(corner, -1, axis=1).ravel()
    directed = sparse.coo_matrix((np.ones(len(one)), (one, other)), (count, count)).tocsr()
    rim = abs(directed - directed.T)
    rim.eliminate_zeros()
    degree = np.asarray(rim.sum(1)).ravel()
    border = degree > 0
    parts, part = connected_components(directed, directed=False)
    if len(np.unique(part[border])) < parts:
        return None
    uv = uv.copy()
    for _ in range(rounds):
        middle = (rim @ uv)[border] / degree[border, None]
        uv[border] = 0.5 * (uv[border] + middle)

    inner = np.flatnonzero(~border)
    if len(inner):
        links = ((directed + directed.T) > 0).astype(float)
        laplacian = (sparse.diags(np.asarray(links.sum(1)).ravel()) - links).tocsr()[inner]
        right = -(laplacian[:, border] @ uv[border])
        uv[inner] = np.asarray(spsolve(laplacian[:, inner].tocsc(), right)).reshape(-1, 2)
    return uv


def _halves(vertices: np.ndarray, faces: np.ndarray, members: np.ndarray) -> list[np.ndarray]:
    """A chart's triangles in connected parts of about half its size: grown from the two triangles
    that differ most in normal and place.
    """
    near = adjacency(faces)
    normals, area = face_normals(vertices, faces)
    middle = vertices[faces].mean(1)
    place = np.concatenate([normals, middle / max(np.ptp(middle, axis=0).max(), 1e-20)], 1)
    first = int(np.argmax(((place - place.mean(0)) ** 2).sum(1)))
    second = int(np.argmax(((place - place[first]) ** 2).sum(1)))
    if second == first:
        second = (first + 1) % len(faces)
    seeds = np.array([first, second])
    reach = float(np.linalg.norm(np.ptp(middle, axis=0))) + 1e-20
    chart = np.full(len(faces), -1)
    _grow(chart, 0, seeds, normals[seeds], near, normals, middle, reach, -2.0)
    return [members[chart == k] for k in (-1, 0, 1) if (chart == k).any()]
