"""What a free highlight could gain on real photos: the plain textured mesh, plus any function of
the reflected direction.

python -m benchmarks.view_dependence --work work/brass_head work/banana [--out rows.json]

A lit asset can beat the plain textured mesh (`benchmarks.unlit`) only by what changes as the camera
moves. Under a distant light a highlight is a function of the direction that the view is reflected
in, and of the angle. Here that function is free: no light, no roughness, no metal, one for each
group of colours or one for all. So a row says how much of the held-out photos such a highlight
explains on this surface and with these cameras, and what the asset's samples have of it. It is no
strict bound: light that is blocked or comes from nearby, and gloss that differs within a colour,
are not in it.

The model, in sRGB values: c = t(uv) + sum_k (B_k + F_k (1 - cosine)^5) g_k(r), t the texture, r the
unit reflected direction, g_k normalised Gaussians about LOBES directions evenly over the sphere, of
the width of their distance. B and F are ridge regression within texels (fixed effects: means of
each texel are taken off both sides), so that t is free. Number of directions, ridge and whether
groups of colours differ are those that predict photos of the fit best that are left out in FOLDS
parts. Held-out photos choose nothing.

A row: `scene`; `unlit_psnr`; `free_psnr` of the model and `free`, its choice; `lit_psnr` of every
sample, where there are samples. All in the pixels that the samples were scored in.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from benchmarks.unlit import (
    OUTLIER,
    SUBPIXELS,
    PhotoPixels,
    bake,
    configured_side,
    lit_samples,
    picture,
    rows_of_scenes,
)
from pipeline.base.errors import run_stage
from pipeline.base.files import read_json
from pipeline.base.images import linear_to_srgb, read_exr, srgb_to_linear
from pipeline.base.progress import progress
from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.cameras import View
from pipeline.geometry.surface import Surface
from pipeline.posterior.ladder import bodies
from pipeline.posterior.textures import gather
from pipeline.render.metrics import held_out_photos, psnr, scored_pixels
from pipeline.render.observe import Observations, Tracer, object_pixels
from pipeline.render.shading_normals import shading_normals

PIXELS = 1_500_000  # of all photos together that make textures
FITTED = 300_000  # of them that make the highlight
FEW, MANY = 32, 128  # directions over the sphere
RIDGES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # shares of the mean square of a column
FOLDS = 4  # parts that the photos are left out in, one after the other
PER_TEXEL = 16  # pixels, about: of the texels whose means are taken off
CHUNK = 50_000  # pixels at once


@dataclass(frozen=True)
class Seen:
    """Where rays meet the surface: uv (n, 2), reflected (n, 3) unit directions in the world's
    frame, cosine (n,) between normal and ray.
    """

    uv: np.ndarray
    reflected: np.ndarray
    cosine: np.ndarray

    def of(self, index: np.ndarray) -> Seen:
        return Seen(self.uv[index], self.reflected[index], self.cosine[index])


@dataclass(frozen=True)
class Highlight:
    """Weights (2 groups K, 3) of the model's columns; centres (K, 3); body (t, t) numbers a texel's
    group of colours, of `groups`.
    """

    centres: np.ndarray
    body: np.ndarray
    groups: int
    weights: np.ndarray

    def color(self, seen: Seen) -> np.ndarray:
        """(n, 3), what is added to the texture."""
        return columns(seen, self.centres, self.body, self.groups) @ self.weights


def see(
    tracer: Tracer, surface: Surface, view: View, points: np.ndarray
) -> tuple[Seen, np.ndarray]:
    """Rays through points (n, 2), column and row, of a view: what those see that meet the surface,
    and which ones do (n,).
    """
    origins, directions = view.rays(points)
    si = tracer.scene.ray_intersect(mitsuba_rays(origins, directions))
    hit = np.array(si.is_valid()).astype(bool)
    normal = shading_normals(si, surface)[hit]
    ray = directions[hit]
    along = (normal * ray).sum(1, keepdims=True)
    uv = np.array(si.uv).T.reshape(-1, 2)[hit].astype(np.float32)
    reflected = (ray - 2 * along * normal).astype(np.float32)
    return Seen(uv, reflected, np.abs(along[:, 0]).astype(np.float32)), hit


def even_directions(count: int) -> np.ndarray:
    """(count, 3) evenly over the sphere (Fibonacci lattice; Gonzalez 2010)."""
    k = np.arange(count) + 0.5
    up, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    side = np.sqrt(1 - up**2)
    return np.stack([side * np.cos(turn), side * np.sin(turn), up], -1).astype(np.float32)


def columns(seen: Seen, centres: np.ndarray, body: np.ndarray, groups: int) -> np.ndarray:
    """The model's columns (n, 2 groups K), float32."""
    width = 4 * np.pi / len(centres)  # solid angle of one direction, about its distance squared
    g = np.exp((seen.reflected @ centres.T - 1) / width)
    g /= g.sum(1, keepdims=True)
    grazing = (1 - np.minimum(seen.cosine, 1))[:, None] ** 5
    both = np.concatenate([g, grazing * g], 1)
    if groups == 1:
        return both
    of = gather(body.astype(np.float32), seen.uv)[:, 0].round().astype(int)
    out = np.zeros((len(both), groups, both.shape[1]), np.float32)
    out[np.arange(len(both)), of] = both
    return out.reshape(len(both), -1)


def texel_of(uv: np.ndarray) -> np.ndarray:
    """Number (n,) of the texel that a texture coordinate (n, 2) lies in, of a map with PER_TEXEL
    pixels a texel.
    """
    side = max(round((len(uv) / PER_TEXEL) ** 0.5), 1)
    column, row = np.clip((side * uv).astype(int), 0, side - 1).T
    return row * side + column


def runs(texel: np.ndarray) -> list[slice]:
    """Pieces of sorted texel numbers (n,), of about CHUNK, each texel in one of them."""
    starts = np.flatnonzero(np.r_[True, np.diff(texel) > 0])
    cuts = starts[np.unique(np.searchsorted(starts, np.arange(0, len(texel), CHUNK)))[:-1]]
    edges = np.unique(np.r_[0, cuts, len(texel)])
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:])]


def products(
    seen: Seen, moving: np.ndarray, weight: np.ndarray, kept: np.ndarray, made: Highlight
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Normal equations (C, C), (C, 3) and the sum of squares () of the pixels that are `kept` (n,),
    and of the others; all less the weighted means of the kept ones in their texel. Texels without
    any count for nothing.
    """
    texel = texel_of(seen.uv)
    order = np.argsort(texel, kind="stable")
    texel = texel[order]
    count = 2 * made.groups * len(made.centres)
    sums = [[np.zeros((count, count)), np.zeros((count, 3)), np.zeros(())] for _ in range(2)]
    for piece in runs(texel):
        index = order[piece]
        x = columns(seen.of(index), made.centres, made.body, made.groups)
        both = np.concatenate([x, moving[index]], 1)
        first = np.flatnonzero(np.r_[True, np.diff(texel[piece]) > 0])
        w = (weight[index] * kept[index])[:, None]
        total = np.add.reduceat(w, first, 0)
        mean = np.add.reduceat(w * both, first, 0) / np.maximum(total, 1e-9)
        lengths = np.diff(np.r_[first, len(index)])
        both -= np.repeat(mean, lengths, 0)
        known = np.repeat(total[:, 0] > 0, lengths)
        for part, mine in zip(sums, (kept[index], known & ~kept[index])):
            root = np.sqrt(weight[index][mine])[:, None] * both[mine]
            part[0] += root[:, :count].T @ root[:, :count]
            part[1] += root[:, :count].T @ root[:, count:]
            part[2] += (root[:, count:] ** 2).sum()
    return sums[0], sums[1]


def solved(equations: list[np.ndarray], ridge: float) -> np.ndarray:
    """Weights (C, 3)."""
    A, b, _ = equations
    return np.linalg.solve(A + ridge * np.diag(A).mean() * np.eye(len(A)), b)


def left(equations: list[np.ndarray], weights: np.ndarray) -> float:
    """Sum of squares that weights (C, 3) leave."""
    A, b, squares = equations
    return float(squares - 2 * (b * weights).sum() + (weights * (A @ weights)).sum())


def fitted(
    seen: Seen, moving: np.ndarray, weight: np.ndarray, photo: np.ndarray, body: np.ndarray
) -> tuple[Highlight, dict]:
    """The highlight that predicts left-out photos best, from all of them; and the choice: `lobes`,
    `groups`, `ridge`, `left` (share of the left-out squares that it leaves). moving (n, 3): what
    photos show beyond a texture, sRGB; photo (n,): their numbers.
    """
    names = np.unique(photo)
    part_of = np.random.default_rng(0).permutation(len(names)) % FOLDS
    fold = part_of[np.searchsorted(names, photo)]
    best: tuple[float, Highlight, float] | None = None
    most = int(body.max()) + 1
    for lobes, groups in dict.fromkeys(((FEW, 1), (MANY, 1), (FEW, most))):
        made = Highlight(even_directions(lobes), body, groups, np.zeros(0))
        parts = [products(seen, moving, weight, fold != k, made) for k in range(FOLDS)]
        without = sum(float(judged[2]) for _, judged in parts)
        for ridge in RIDGES:
            share = sum(left(judged, solved(own, ridge)) for own, judged in parts) / without
            if best is None or share < best[0]:
                best = share, made, ridge
    assert best is not None
    share, made, ridge = best
    own, _ = products(seen, moving, weight, np.ones(len(photo), bool), made)
    found = Highlight(made.centres, body, made.groups, solved(own, ridge))
    choice = {"lobes": len(made.centres), "groups": made.groups, "ridge": ridge, "left": share}
    return found, choice


def photo_table(
    views: list[View], work: Path, tracer: Tracer, surface: Surface, erode: float
) -> tuple[Seen, np.ndarray, np.ndarray]:
    """PIXELS of the photos inside their masks: what they see, colours (n, 3) in sRGB, and the
    photo's number (n,).
    """
    inside = object_pixels(views, work / "mesh", erode)
    share = min(1.0, PIXELS / sum(len(pixels) for pixels in inside))
    rng = np.random.default_rng(0)
    parts = []
    for number, (view, pixels) in enumerate(zip(progress(views, "photos"), inside)):
        rows, cols = rng.permutation(pixels)[: round(share * len(pixels))].T
        seen, hit = see(tracer, surface, view, np.stack([cols, rows], -1) + 0.5)
        color = linear_to_srgb(read_exr(work / "poses" / view.image)[rows, cols])[hit]
        parts.append((seen, color.astype(np.float32), np.full(len(color), number)))
    joined = lambda name: np.concatenate([getattr(seen, name) for seen, _, _ in parts])
    seen = Seen(joined("uv"), joined("reflected"), joined("cosine"))
    return seen, *(np.concatenate(column) for column in list(zip(*parts))[1:])


def highlighted(
    view: View,
    mask: np.ndarray,
    texture: np.ndarray,
    highlight: Highlight,
    tracer: Tracer,
    surface: Surface,
) -> np.ndarray:
    """The textured mesh with the highlight in `view`, linear (h, w, 3), inside `mask`; each pixel
    the mean of SUBPIXELS^2 rays.
    """
    rows, cols = np.nonzero(mask)
    corner = np.stack([cols, rows], -1)
    total = np.zeros((len(rows), 3))
    for step in np.ndindex(SUBPIXELS, SUBPIXELS):
        seen, hit = see(tracer, surface, view, corner + (np.array(step) + 0.5) / SUBPIXELS)
        color = gather(texture, seen.uv) + highlight.color(seen)
        total[hit] += srgb_to_linear(np.clip(color, 0, 1))
    out = np.zeros(mask.shape + (3,), np.float32)
    out[rows, cols] = total / SUBPIXELS**2
    return out


def free_highlight(
    seen: Seen, color: np.ndarray, photo: np.ndarray, plain: np.ndarray, side: int
) -> tuple[Highlight, np.ndarray, dict]:
    """The highlight that photos show beyond the texture `plain`, the texture (side, side, 3), sRGB,
    that remains beside it, and the choice of `fitted`. color (n, 3), sRGB; photo (n,), numbers.
    """
    moving = color - gather(plain, seen.uv)
    weight = seen.cosine / (1 + (np.abs(moving).mean(-1) / OUTLIER) ** 2) ** 2
    body = bodies(srgb_to_linear(plain), seen.uv, np.random.default_rng(0))
    some = np.random.default_rng(0).permutation(len(photo))[:FITTED]
    highlight, choice = fitted(seen.of(some), moving[some], weight[some], photo[some], body)

    parts = np.split(np.arange(len(color)), range(CHUNK, len(color), CHUNK))
    rest = np.concatenate([color[part] - highlight.color(seen.of(part)) for part in parts])
    texture, _ = bake(PhotoPixels(seen.uv, rest.astype(np.float32), seen.cosine), side)
    return highlight, texture, choice


def row(work: Path, erode: float) -> dict:
    """Scores of a finished scene. Raises InputError where a stage is missing."""
    samples = [read_json(folder / "refine.json") for folder in lit_samples(work)]
    side = configured_side(work, len(read_exr(lit_samples(work)[0] / "base_color.exr")))
    observations = Observations(work / "observe", work / "poses" / "cameras.json")
    problem = SimpleNamespace(observations=observations, renderer=None)
    held_out = held_out_photos(problem, work / "poses", work / "mesh", erode)
    mesh = work / "atlas" / "mesh_uv.ply"
    tracer, surface = Tracer(mesh), Surface.of(mesh)

    seen, color, photo = photo_table(observations.views, work, tracer, surface, erode)
    plain, _ = bake(PhotoPixels(seen.uv, color, seen.cosine), side)
    highlight, texture, choice = free_highlight(seen, color, photo, plain, side)

    chosen = scored_pixels(held_out, samples[0]["held_out_pixels"])
    pictures = {
        "unlit": lambda view, some: picture(view, some, plain, tracer),
        "free": lambda view, some: highlighted(view, some, texture, highlight, tracer, surface),
    }
    scores = {
        name: {
            view.name: psnr(shown(view, some), true, some)
            for (view, true, _), some in zip(held_out, chosen)
        }
        for name, shown in pictures.items()
    }
    mean = lambda found: float(np.mean(list(found.values())))
    return {
        "scene": work.resolve().name,
        "unlit_psnr": mean(scores["unlit"]),
        "free_psnr": mean(scores["free"]),
        "free": choice,
        "lit_psnr": [sample["held_out_psnr"] for sample in samples],
        "views": scores,
    }


def main() -> None:
    rows_of_scenes(__doc__, row, unprinted="views")


if __name__ == "__main__":
    run_stage(main)
