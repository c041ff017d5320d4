"""Step 7 of split_gibbs: a state as an explanation, a light and texture maps."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.posterior.split_gibbs.likelihood import RowLikelihood, point_materials
from pipeline.posterior.split_gibbs.setup import Model
from pipeline.posterior.split_gibbs.state import Randomness, State
from pipeline.posterior.textures import fill, splat
from pipeline.render.renderer import Explanation

# of the texture's side: roughness of the points of a region, and which kind most are of, run into
# each other over as much
SOFT = 48


def maps(rng: Randomness, model: Model, state: State, light: np.ndarray) -> dict[str, np.ndarray]:
    """Texture maps under the operator's light (M', 3): a drawn base colour per point spread over
    its texels; roughness and metallic within regions only, so that they end where colours do.
    Roughness is the material's own: what the normals' spread adds is left out.
    """
    data, size = model.data, model.settings.texture
    rows = RowLikelihood.of(model.mixer, state)
    _, _, colors = rows.draw_colors(light, rng.numpy)
    counted = np.concatenate([colors, np.ones((len(colors), 1))], 1)
    total = splat(model.uv, counted[data.rows.point], size)
    base_color = cv2.GaussianBlur(spread(total)[..., :3], (0, 0), 1.0)

    step, metallic = point_materials(data, state.materials, state.offsets)
    roughness = np.array(data.lobes.roughness)[step]
    out = {name: np.zeros((size, size)) for name in ("roughness", "metallic")}
    for r in range(len(state.materials)):
        mine, here = data.row_region == r, model.region_map == r
        of_rows = data.rows.point[mine]
        found = region_maps(model.uv[mine], roughness[of_rows], metallic[of_rows], size)
        for name, value in zip(out, found):
            out[name][here] = value[here]
    out["base_color"] = np.clip(base_color, 0, 1)
    return {name: value.astype(np.float32) for name, value in out.items()}


def region_maps(
    uv: np.ndarray, roughness: np.ndarray, metallic: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Roughness and metallic (size, size) of one region from its rows (n,) at uv (n, 2): roughness
    as their local mean, in its log; metallic, 0 or 1, as what most of them are there.
    """
    counted = np.stack([np.log(roughness), metallic, np.ones(len(uv))], 1)
    soft = cv2.GaussianBlur(spread(splat(uv, counted, size)), (0, 0), max(size / SOFT, 0.5))
    return np.exp(soft[..., 0]), (soft[..., 1] > 0.5).astype(float)


def spread(total: np.ndarray) -> np.ndarray:
    """Means (t, t, c) from sums and, last, counts (t, t, c + 1); the nearest elsewhere."""
    known = total[..., -1] > 0.05
    return fill(total[..., :-1] / np.maximum(total[..., -1:], 1e-6), known)


def facts(model: Model, state: State) -> dict:
    """What sample.json says of a draw."""
    data, materials = model.data, state.materials
    roughness = data.lobes.roughness
    return {
        "scale": float(np.exp(state.log_scale)),
        "rows": len(data.rows.point),
        "points": len(data.region),
        "relative_error": state.noise.scale,
        "design_effect": state.noise.design_effect,
        "normal_spread": float(np.median(data.lobes.spreads[state.offsets[2]])),
        "regions": [
            {
                "base_color": materials.color[r].tolist(),
                "spread": float(materials.spread[r]),
                "metallic": float(materials.metallic[r]),
                "roughness": roughness[materials.roughness[r]],
                "points": int((data.region == r).sum()),
            }
            for r in range(len(materials))
        ],
    }


def explanation(
    rng: Randomness, model: Model, state: State, fit: Explanation
) -> tuple[Explanation, dict]:
    """Step 7: the draw as an explanation, and its facts; `state.code` is a code of the diffusion
    prior.
    """
    decoder = model.decoder(model.prior)
    light = decoder.light(state.code, state.log_scale)
    drawn = maps(rng, model, state, light)
    env = decoder.map(state.code, state.log_scale)
    return Explanation(env, **drawn, ior=fit.ior), facts(model, state)
