"""What may be wrong with a given mesh. Every function takes the mesh, how much is wrong, and a
generator; it returns the spoilt mesh. At 0 nothing changes. Lengths are shares of the object's
radius, the greatest distance of a vertex from the origin.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.geometry.mesh_io import Mesh, vertex_adjacency, vertex_normals


def radius(mesh: Mesh) -> float:
    return float(np.linalg.norm(mesh.vertices, axis=1).max())


def shifted(mesh: Mesh, share: float, rng) -> Mesh:
    """Moved sideways."""
    along = np.array([np.cos(0.7), np.sin(0.7), 0])
    return replace(mesh, vertices=mesh.vertices + share * radius(mesh) * along)


def scaled(mesh: Mesh, share: float, rng) -> Mesh:
    """Too large by this share."""
    return replace(mesh, vertices=mesh.vertices * (1 + share))


def holes(mesh: Mesh, share: float, rng) -> Mesh:
    """Without this share of its triangles, in round patches of about a hundredth of all."""
    centres = mesh.vertices[mesh.faces].mean(1)
    gone = np.zeros(len(centres), bool)
    wanted = round(share * len(centres))
    while gone.sum() < wanted:
        size = min(max(len(centres) // 100, 1), wanted - int(gone.sum()))
        left = np.flatnonzero(~gone)
        away = np.linalg.norm(centres[left] - centres[rng.choice(left)], axis=1)
        gone[left[np.argsort(away)[:size]]] = True
    return replace(mesh, faces=mesh.faces[~gone])


def flipped(mesh: Mesh, share: float, rng) -> Mesh:
    """This share of its triangles inside out, and the normals that they make."""
    if share == 0:
        return mesh
    turn = rng.permutation(len(mesh.faces)) < round(share * len(mesh.faces))
    faces = np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces)
    return replace(mesh, faces=faces, normals=vertex_normals(mesh.vertices, faces))


def rough(mesh: Mesh, share: float, rng) -> Mesh:
    """Vertices displaced along their normals by noise of this standard deviation, smoothed over
    neighbours; points that several vertices share move together.
    """
    if share == 0:
        return mesh
    point = np.unique(np.round(mesh.vertices, 5), axis=0, return_inverse=True)[1].reshape(-1)
    noise = rng.normal(size=point.max() + 1)
    near = vertex_adjacency(len(noise), point[mesh.faces]).astype(float)
    count = np.maximum(np.asarray(near.sum(1)).ravel(), 1)
    for _ in range(2):
        noise = 0.5 * noise + 0.5 * (near @ noise) / count
    moved = (share * radius(mesh) * noise / noise.std())[point]
    vertices = mesh.vertices + moved[:, None] * mesh.normals
    one_of_each = np.zeros((point.max() + 1, 3))
    one_of_each[point] = vertices
    normals = vertex_normals(one_of_each, point[mesh.faces])[point]
    return replace(mesh, vertices=vertices, normals=normals)


def overlapping_uv(mesh: Mesh, share: float, rng) -> Mesh:
    """Texture coordinates of the right part of the page moved left onto the rest of it, so that
    `share` of the page's width is used twice.
    """
    uv = mesh.uv.copy()
    right = uv[:, 0] > 1 - share
    uv[right, 0] -= share
    return replace(mesh, uv=uv)
