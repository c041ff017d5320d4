"""The forward model R(light, materials, camera): a triangle mesh with principled materials under a
distant light.

Mitsuba 3, `principled` BSDF (all that is not said here 0), `prb` path replay (Vicini et al. 2021).
Pixels are drawn over all views at once and rendered as one batch of camera rays, no film involved.

Shapes: origins, directions (n, 3) of camera rays; radiance (n, 3); light (h, 2h, 3) lat-long
radiance, row 0 = +Y; base_color (t, t, 3), roughness, metallic (t, t) in [0, 1], row 0 is v = 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import drjit as dr
import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json
from pipeline.base.images import read_exr, write_exr
from pipeline.base.runtime import mitsuba as mi
from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.surface import Surface
from pipeline.render.envmap import mitsuba_gradient, to_mitsuba
from pipeline.render.shading_normals import with_normal_map
from pipeline.render.surroundings import Ground

BSDF = "principled"  # Mitsuba's name of the material's model
LIGHT = "light.data"  # Mitsuba's name of the light's pixels
MATERIAL = "obj.bsdf."  # begins the names of the object's textures
MAPS = ("base_color", "roughness", "metallic")
GLASS = 1.5  # index of refraction of most dielectrics, within a tenth
NO_HIGHLIGHT = 1.0  # of what has none
# roughness at which the diffuse lobe is nearest to Lambert's, where there is no other lobe
LAMBERTIAN = 0.5

# radiance (n, 3) of n pixels -> the loss, and its derivative (n, 3) in the radiance
LossAndSlope = Callable[[np.ndarray], tuple[float, np.ndarray]]
# random numbers -> origins and directions (n, 3) of one freshly jittered ray per pixel
JitteredRays = Callable[[np.random.Generator], tuple[np.ndarray, np.ndarray]]


@dataclass
class Explanation:
    """One explanation of the photos: a light, three material maps, and the index of refraction
    that the surface's highlight has where it is no metal.
    """

    light: np.ndarray
    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    ior: float = field(default=GLASS, kw_only=True)

    def save(self, folder: Path) -> None:
        """light.exr, base_color.exr, roughness.exr, metallic.exr, 32-bit float; ior.json."""
        for part in ARRAYS:
            write_exr(folder / f"{part}.exr", getattr(self, part))
        write_json(folder / "ior.json", {"ior": self.ior})

    @classmethod
    def load(cls, folder: Path) -> Explanation:
        """What `save` wrote. Without ior.json, as runs before there was one have it, GLASS."""
        folder = Path(folder)
        ior = read_json(folder / "ior.json")["ior"] if (folder / "ior.json").exists() else GLASS
        return cls(*(read_exr(folder / f"{part}.exr") for part in ARRAYS), ior=ior)

    def copy(self) -> Explanation:
        """The same values in arrays of its own."""
        return Explanation(*(getattr(self, part).copy() for part in ARRAYS), ior=self.ior)


ARRAYS = ("light", *MAPS)  # of an Explanation


def head_on(ior: float) -> float:
    """Share of light that a dielectric reflects head-on, in air (Fresnel)."""
    return ((ior - 1) / (ior + 1)) ** 2


def ior_of(reflectance: float) -> float:
    """The index of refraction of a dielectric that reflects this share of light head-on."""
    return (1 + reflectance**0.5) / (1 - reflectance**0.5)


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


def _blank_texture(side: int, channels: int) -> dict:
    """A texture that `Renderer.set` fills."""
    return {
        "type": "bitmap",
        "raw": True,
        "wrap_mode": "clamp",
        "data": mi.TensorXf(np.full((side, side, channels), 0.5, np.float32)),
    }


def _scene(surface: Surface, texture: int, light_height: int, ground: Ground | None) -> Any:
    """Mitsuba scene of a surface with its normal map and blank textures of side `texture` under a
    constant light, on the `ground` if there is one.
    """
    light = np.ones((2 * light_height + 1, 2 * light_height, 3), np.float32)  # as `to_mitsuba`
    material = {
        "type": BSDF,
        "specular": specular(GLASS),
        "base_color": _blank_texture(texture, 3),
        "roughness": _blank_texture(texture, 1),
        "metallic": _blank_texture(texture, 1),
    }
    shape = {
        "type": "ply",
        "filename": str(surface.mesh),
        "flip_tex_coords": True,
        "bsdf": {"type": "twosided", "b": with_normal_map(material, surface)},
    }
    parts = {
        "type": "scene",
        "light": {"type": "envmap", "bitmap": mi.Bitmap(light)},
        "obj": shape,
    }
    return mi.load_dict(parts if ground is None else parts | {"ground": ground.shape()})


def specular(ior: float) -> float:
    """Mitsuba's parameter of `principled`: the reflectance head-on as a share of .08."""
    return head_on(ior) / 0.08


def parameter_keys(names: Iterable[str]) -> dict[str, str]:
    """Mitsuba's names of the light, of each of MAPS and of the highlight's strength, among all
    `names` of a scene's parameters: each is known by what it is called, whatever its material is
    wrapped in.
    """
    of_material = [name for name in names if name.startswith(MATERIAL)]
    endings = {part: f".{part}.data" for part in MAPS} | {"specular": ".specular"}
    keys = {"light": LIGHT}
    for part, ending in endings.items():
        (keys[part],) = (name for name in of_material if name.endswith(ending))
    return keys


def crossed_adjoint(paths: np.ndarray, loss_and_slope: LossAndSlope) -> tuple[float, np.ndarray]:
    """Loss, and its derivative (spp pixels, 3) in every path's radiance; paths (spp, pixels, 3).

    The two halves of the paths give independent estimates A and B of each pixel. A's paths are
    differentiated with the residual of B and the other way round, so that noise in the residual and
    noise in the derivative are independent and the gradient of a quadratic loss is unbiased.
    """
    spp, pixels, _ = paths.shape
    half = spp // 2
    loss_a, slope_a = loss_and_slope(paths[:half].mean(0))
    loss_b, slope_b = loss_and_slope(paths[half:].mean(0))

    for_a = np.broadcast_to(slope_b / spp, (half, pixels, 3))
    for_b = np.broadcast_to(slope_a / spp, (half, pixels, 3))
    return 0.5 * (loss_a + loss_b), np.concatenate([for_a, for_b]).reshape(-1, 3)


class Renderer:
    """A mesh with textures of side `texture` under a light of `light_height` rows. Where the
    mesh has a normal map (pipeline/geometry/surface.py) it shades with that.

    max_depth counts as in Mitsuba: 2 = direct light only, 4 = up to three surface interactions.
    ground: shines on the object and hides the light below it; cameras do not see it. `scene` is of
    the object alone, for rays that look for its surface. Raises InputError where the mesh does not
    exist.
    """

    def __init__(
        self,
        mesh: Path,
        texture: int,
        light_height: int,
        max_depth: int,
        ground: Ground | None = None,
    ):
        if not Path(mesh).exists():
            raise InputError("the mesh does not exist", mesh, "run the atlas stage first")
        self.surface = Surface.of(mesh)
        self.max_depth = max_depth
        self.texture = texture
        self.light_shape = (light_height, 2 * light_height, 3)

        self.ground = ground
        self.scene = _scene(self.surface, texture, light_height, None)
        self.lit = self.scene
        if ground is not None:
            self.lit = _scene(self.surface, texture, light_height, ground)
        self.params = mi.traverse(self.lit)
        self.keys = parameter_keys(self.params.keys())
        self.params.keep(list(self.keys.values()))
        self.ior = GLASS  # what the scene was last given
        self.integrator = mi.load_dict(
            {"type": "prb", "max_depth": max_depth, "rr_depth": 1000, "hide_emitters": True}
        )

    @property
    def mesh(self) -> Path:
        """The surface's mesh file."""
        return self.surface.mesh

    def at_texture(self, side: int) -> Renderer:
        """The same with textures of another side."""
        return Renderer(self.mesh, side, self.light_shape[0], self.max_depth, self.ground)

    def set(self, explanation: Explanation, differentiable: bool = False) -> dict:
        """Load an explanation into the scene; returns the tensors, by name, that gradients arrive
        at.
        """
        arrays = {
            "light": to_mitsuba(explanation.light),
            "base_color": explanation.base_color,
            "roughness": explanation.roughness[..., None],
            "metallic": explanation.metallic[..., None],
        }
        leaves = {}
        for name, array in arrays.items():
            leaf = mi.TensorXf(np.ascontiguousarray(array, np.float32))
            if differentiable:
                dr.enable_grad(leaf)
            self.params[self.keys[name]] = leaf
            leaves[name] = leaf
        if explanation.ior != self.ior:
            self.params[self.keys["specular"]] = mi.Float(specular(explanation.ior))
            self.ior = explanation.ior

        self.params.update()
        return leaves

    def _trace(
        self,
        mode: dr.ADMode,
        origins: np.ndarray,
        directions: np.ndarray,
        seed: int,
        adjoint: Any = None,
        state: Any = None,
    ) -> tuple[Any, Any, Any, Any]:
        """What Mitsuba's integrator returns for rays (n, 3): radiance, which paths count, further
        outputs, and the state that the backward pass takes with the radiance's `adjoint`.
        """
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, len(origins))
        return self.integrator.sample(
            mode=mode,
            scene=self.lit,
            sampler=sampler,
            ray=mitsuba_rays(origins, directions),
            δL=adjoint,
            state_in=state,
            active=mi.Bool(True),
        )

    def radiance(self, origins: np.ndarray, directions: np.ndarray, seed: int) -> np.ndarray:
        """One path per ray: (n, 3). The scene is what `set` was last given."""
        with dr.suspend_grad():
            radiance = self._trace(dr.ADMode.Primal, origins, directions, seed)[0]
            return np.array(radiance).T.reshape(-1, 3)

    def mean_radiance(
        self, rays: JitteredRays, spp: int, seed: int, chunk: int = 1 << 19
    ) -> np.ndarray:
        """Average of `spp` paths per pixel, (n, 3). `rays(rng)` gives freshly jittered origins and
        directions (n, 3). The scene is what `set` was last given. About `chunk` rays are traced at
        a time, of several paths per pixel where there are few pixels: a launch has a price.
        """
        rng = np.random.default_rng(seed)
        total: np.ndarray | float = 0.0
        waiting: list[tuple[np.ndarray, np.ndarray]] = []
        for k in range(spp):
            waiting.append(rays(rng))
            pixels = len(waiting[0][0])
            if k + 1 < spp and (len(waiting) + 1) * pixels <= chunk:
                continue
            origins, directions = (np.concatenate(parts) for parts in zip(*waiting))
            parts = [
                self.radiance(
                    origins[i : i + chunk], directions[i : i + chunk], int(rng.integers(1 << 31))
                )
                for i in range(0, len(origins), chunk)
            ]
            total = total + np.concatenate(parts).reshape(len(waiting), pixels, 3).sum(0)
            waiting = []
        return np.asarray(total / spp, np.float32)

    def gradient(
        self,
        explanation: Explanation,
        origins: np.ndarray,
        directions: np.ndarray,
        pixels: int,
        loss_and_slope: LossAndSlope,
        seed: int,
    ) -> Gradient:
        """Unbiased gradient of a quadratic loss over `pixels` pixels (see `crossed_adjoint`).

        origins, directions: (spp, pixels, 3) with spp even. `loss_and_slope(radiance) -> (loss,
        derivative of the loss in radiance)` for the mean radiance (pixels, 3).
        """
        spp = origins.shape[0]
        leaves = self.set(explanation, differentiable=True)
        origins = origins.reshape(-1, 3)
        directions = directions.reshape(-1, 3)

        with dr.suspend_grad():
            radiance, _, _, state = self._trace(dr.ADMode.Primal, origins, directions, seed)
            dr.eval(radiance, state)
            paths = np.array(radiance).T.reshape(spp, pixels, 3)
            loss, slope = crossed_adjoint(paths, loss_and_slope)

            adjoint = mi.Color3f(np.ascontiguousarray(slope.T, np.float32))
            self._trace(dr.ADMode.Backward, origins, directions, seed, adjoint, state)

        # the derivative of a path over a mirror or at a grazing angle may overflow: one such path
        # must not spoil the whole map
        finite = lambda leaf: np.nan_to_num(
            np.array(dr.grad(leaf)), nan=0.0, posinf=0.0, neginf=0.0
        )
        return Gradient(
            mitsuba_gradient(finite(leaves["light"])),
            finite(leaves["base_color"]),
            finite(leaves["roughness"])[..., 0],
            finite(leaves["metallic"])[..., 0],
            loss,
        )


def resized(image: np.ndarray, side: int) -> np.ndarray:
    """A map (t, t) or (t, t, c) at another size (area down, linear up)."""
    how = cv2.INTER_AREA if side < image.shape[0] else cv2.INTER_LINEAR
    return cv2.resize(image, (side, side), interpolation=how)


def resize_explanation(
    explanation: Explanation, texture: int, gloss: int | None = None
) -> Explanation:
    """The same maps at another texture size; roughness and metallic of side `gloss`, none: as the
    base colour. A metallic of metal and none stays one, whose borders lie where they did.
    """
    side = gloss or texture
    return replace(
        explanation,
        base_color=resized(explanation.base_color, texture),
        roughness=resized(explanation.roughness, side),
        metallic=resized_metallic(explanation.metallic, side),
    )


def resized_metallic(metallic: np.ndarray, side: int) -> np.ndarray:
    """Metallic (t, t) at another size: 0 or 1 by what most of a texel is, where it is so
    everywhere.
    """
    new = resized(metallic, side)
    decided = np.isin(metallic, (0, 1)).all()
    return (new > 0.5).astype(metallic.dtype) if decided else new
