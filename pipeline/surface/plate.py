"""A surface as a thin plate: the movement that balances what pulls at it and its own stiffness.

Letters: x vertices; n their normals; g, h first and second derivative of what pulls, by a vertex's
movement m along its normal; L the umbrella operator: mean of the neighbours minus the vertex.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import unit, vertex_adjacency, vertex_normals

LONGEST = 1.0  # footprints that a vertex moves in one step
ANCHOR = 3e-3  # weight of staying at home, per pixel, with one footprint as unit
SOLVER_STEPS = 60  # of conjugate gradients, per step
EVEN = 0.2  # share of the way to its neighbours' mean that a vertex glides within the surface


def umbrella(count: int, faces: np.ndarray) -> sparse.csr_matrix:
    """The operator L (n, n): mean of a vertex's neighbours minus the vertex; zero row where it has
    none.
    """
    edges = vertex_adjacency(count, faces).astype(float)
    degree = np.asarray(edges.sum(1)).ravel()
    mean = sparse.diags(1 / np.maximum(degree, 1)) @ edges
    return (mean - sparse.diags((degree > 0).astype(float))).tocsr()


def footprint_of(x: np.ndarray, views: list[View]) -> float:
    """Side of a pixel on the surface, in the middle of all views."""
    center = x.mean(0)
    depth = [v.project(center[None])[1][0] for v in views]
    return float(np.median([abs(d) / v.fx for d, v in zip(depth, views)]))


class Plate:
    """Thin plate over a mesh's vertices.

    Its energy is stiffness times the integral of the squared Laplacian of x. With the umbrella
    operator over triangles of edge e that is 16 stiffness / e^2 times the sum of |L x|^2. Where the
    bend |L x . n| exceeds `crease` footprints the weight falls as in Cauchy's robust loss, so that
    an edge that the photos ask for costs little.
    """

    def __init__(self, count: int, faces: np.ndarray, stiffness: float, crease: float):
        self.faces = faces
        self.links = umbrella(count, faces)
        self.stiffness = stiffness
        self.crease = crease

    def area(self, x: np.ndarray) -> np.ndarray:
        """A third of the area of each vertex's triangles (n,)."""
        a, b, c = (x[self.faces[:, corner]] for corner in range(3))
        third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
        return np.bincount(self.faces.ravel(), np.repeat(third, 3), len(x))

    def step(
        self, x: np.ndarray, home: np.ndarray, g: np.ndarray, h: np.ndarray, footprint: float
    ) -> tuple[np.ndarray, float]:
        """The vertices after one step (n, 3), and the median movement in footprints of those that
        are pulled at.

        home: (n, 3), to which a weak spring ties each vertex: without it, the plate would flatten a
        part that nothing pulls at more with every step.
        """
        normals = unit(vertex_normals(x, self.faces))
        edge = x[self.faces[:, 0]] - x[self.faces[:, 1]]
        length = float(np.median(np.linalg.norm(edge, axis=1)))

        bend = self.links @ x
        height = (bend * normals).sum(1)
        give = 1 / (1 + (height / (self.crease * footprint)) ** 2)
        weight = 16 * self.stiffness / length**2 * give
        operator = self.links.T @ sparse.diags(weight) @ self.links
        spring = ANCHOR * self.area(x) / footprint**4
        # of the bend only its part along the normal, which is all that the operator can take away:
        # triangles of uneven size bend within the surface too, and that would pull without end
        pull = g - self.links.T @ (weight * height)
        pull += spring * ((home - x) * normals).sum(1)
        diagonal = h + spring

        move = _solved(operator, diagonal, pull)
        longest = LONGEST * footprint
        move = np.clip(move, -longest, longest)
        glide = bend - height[:, None] * normals
        seen = h > 0
        median = float(np.median(np.abs(move[seen]))) / footprint if seen.any() else 0.0
        return x + move[:, None] * normals + EVEN * glide, median


def _solved(operator: sparse.csr_matrix, diagonal: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """m (n,) with (diagonal + operator) m = pull, by conjugate gradients."""
    scale = 1 / (diagonal + operator.diagonal())
    count = len(pull)
    both = LinearOperator((count, count), matvec=lambda m: diagonal * m + operator @ m)
    before = LinearOperator((count, count), matvec=lambda r: scale * r)
    found, _ = cg(both, pull, M=before, rtol=1e-3, maxiter=SOLVER_STEPS)
    return found
