"""The forward model R(light, materials, camera): a triangle mesh with principled materials under a
distant light.

Mitsuba 3, `principled` BSDF (specular 0.5 = index of refraction 1.5, all else 0), `prb` path replay
(Vicini et al. 2021). Pixels are drawn over all views at once and rendered as one batch of camera
rays, no film involved.

Letters: o, d (n, 3) camera rays; L (n, 3) radiance; light (h, 2h, 3) lat-long radiance, row 0 = +Y;
base_color (t, t, 3), roughness, metallic (t, t) in [0, 1], row 0 is v = 1.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

import drjit as dr
import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, write_exr
from pipeline.base.runtime import mitsuba as mi
from pipeline.base.runtime import mitsuba_rays
from pipeline.render.envmap import mitsuba_gradient, to_mitsuba

BSDF = "obj.bsdf.brdf_0."
KEYS = {
    "light": "light.data",
    "base_color": BSDF + "base_color.data",
    "roughness": BSDF + "roughness.data",
    "metallic": BSDF + "metallic.data",
}


@dataclass
class Explanation:
    """One explanation of the photos: a light and three material maps."""

    light: np.ndarray
    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray

    def save(self, folder: Path) -> None:
        """light.exr, base_color.exr, roughness.exr, metallic.exr, 32-bit float."""
        for f in fields(self):
            write_exr(folder / f"{f.name}.exr", getattr(self, f.name))

    @classmethod
    def load(cls, folder: Path) -> Explanation:
        return cls(*(read_exr(Path(folder) / f"{f.name}.exr") for f in fields(cls)))


@dataclass
class Gradient:
    """Derivative of the loss with respect to each part of an `Explanation`, same shapes; and the
    loss.
    """

    light: np.ndarray
    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    loss: float


class Renderer:
    """A mesh with textures of side `texture` under a light of `light_height` rows.

    max_depth counts as in Mitsuba: 2 = direct light only, 4 = up to three surface interactions.
    """

    def __init__(self, mesh: Path, texture: int, light_height: int, max_depth: int):
        if not Path(mesh).exists():
            raise InputError("the mesh does not exist", mesh, "run the atlas stage first")
        blank = lambda channels: {
            "type": "bitmap",
            "raw": True,
            "wrap_mode": "clamp",
            "data": mi.TensorXf(np.full((texture, texture, channels), 0.5, np.float32)),
        }
        self.scene = mi.load_dict(
            {
                "type": "scene",
                "light": {
                    "type": "envmap",
                    "bitmap": mi.Bitmap(
                        np.ones((2 * light_height + 1, 2 * light_height, 3), np.float32)
                    ),
                },
                "obj": {
                    "type": "ply",
                    "filename": str(mesh),
                    "flip_tex_coords": True,
                    "bsdf": {
                        "type": "twosided",
                        "b": {
                            "type": "principled",
                            "specular": 0.5,
                            "base_color": blank(3),
                            "roughness": blank(1),
                            "metallic": blank(1),
                        },
                    },
                },
            }
        )
        self.params = mi.traverse(self.scene)
        self.params.keep(list(KEYS.values()))
        self.mesh, self.max_depth = Path(mesh), max_depth
        self.texture, self.light_shape = texture, (light_height, 2 * light_height, 3)
        self.integrator = mi.load_dict(
            {"type": "prb", "max_depth": max_depth, "rr_depth": 1000, "hide_emitters": True}
        )

    def _tensors(self, x: Explanation) -> dict:
        flat = {
            "light": to_mitsuba(x.light),
            "base_color": x.base_color,
            "roughness": x.roughness[..., None],
            "metallic": x.metallic[..., None],
        }
        return {
            name: mi.TensorXf(np.ascontiguousarray(value, np.float32))
            for name, value in flat.items()
        }

    def set(self, x: Explanation, differentiable: bool = False) -> dict:
        """Load an explanation into the scene; returns the leaves that gradients arrive at."""
        leaves = self._tensors(x)
        for name, leaf in leaves.items():
            if differentiable:
                dr.enable_grad(leaf)
            self.params[KEYS[name]] = leaf
        self.params.update()
        return leaves

    def _trace(self, mode, o, d, seed: int, adjoint=None, state=None):
        rays = mitsuba_rays(o, d)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(o))
        return self.integrator.sample(
            mode=mode,
            scene=self.scene,
            sampler=sampler,
            ray=rays,
            δL=adjoint,
            state_in=state,
            active=mi.Bool(True),
        )

    def radiance(self, o: np.ndarray, d: np.ndarray, seed: int) -> np.ndarray:
        """One path per ray: (n, 3). The scene is what `set` was last given."""
        with dr.suspend_grad():
            L = self._trace(dr.ADMode.Primal, o, d, seed)[0]
            return np.array(L).T.reshape(-1, 3)

    def mean_radiance(self, rays, spp: int, seed: int, chunk: int = 1 << 19) -> np.ndarray:
        """Average of `spp` paths per pixel, (n, 3). `rays(rng)` gives freshly jittered o, d (n,
        3).
        """
        rng = np.random.default_rng(seed)
        total = 0.0
        for k in range(spp):
            o, d = rays(rng)
            parts = [
                self.radiance(o[i : i + chunk], d[i : i + chunk], seed * 4099 + k)
                for i in range(0, len(o), chunk)
            ]
            total = total + np.concatenate(parts)
        return total / spp

    def gradient(
        self, x: Explanation, o: np.ndarray, d: np.ndarray, pixels: int, dloss, seed: int
    ) -> Gradient:
        """Unbiased gradient of a quadratic loss over `pixels` pixels.

        o, d: (spp, pixels, 3) with spp even. `dloss(L) -> (loss, dloss/dL)` for mean radiance L
        (pixels, 3). The two halves of the paths give independent estimates A and B; A's paths are
        differentiated with the residual of B and the other way round, so that noise in the residual
        and in the derivative is independent.
        """
        spp = o.shape[0]
        leaves = self.set(x, differentiable=True)
        o, d = o.reshape(-1, 3), d.reshape(-1, 3)
        with dr.suspend_grad():
            L, _, _, state = self._trace(dr.ADMode.Primal, o, d, seed)
            dr.eval(L, state)
            paths = np.array(L).T.reshape(spp, pixels, 3)
            a, b = paths[: spp // 2].mean(0), paths[spp // 2 :].mean(0)
            (loss_a, grad_a), (loss_b, grad_b) = dloss(a), dloss(b)
            adjoint = np.concatenate(
                [
                    np.broadcast_to(grad_b / spp, (spp // 2, pixels, 3)),
                    np.broadcast_to(grad_a / spp, (spp // 2, pixels, 3)),
                ]
            ).reshape(-1, 3)
            self._trace(
                dr.ADMode.Backward,
                o,
                d,
                seed,
                mi.Color3f(np.ascontiguousarray(adjoint.T, np.float32)),
                state,
            )
        g = {
            name: np.nan_to_num(np.array(dr.grad(leaf)), nan=0.0, posinf=0.0, neginf=0.0)
            for name, leaf in leaves.items()
        }
        return Gradient(
            mitsuba_gradient(g["light"]),
            g["base_color"],
            g["roughness"][..., 0],
            g["metallic"][..., 0],
            0.5 * (loss_a + loss_b),
        )


def resize_explanation(x: Explanation, texture: int) -> Explanation:
    """The same maps at another texture size (area down, linear up)."""
    import cv2

    how = cv2.INTER_AREA if texture < x.roughness.shape[0] else cv2.INTER_LINEAR
    scale = lambda image: cv2.resize(image, (texture, texture), interpolation=how)
    return replace(
        x, base_color=scale(x.base_color), roughness=scale(x.roughness), metallic=scale(x.metallic)
    )
