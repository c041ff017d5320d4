"""Step 6 of split_gibbs: a state as an explanation, a light and texture maps."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from pipeline.posterior.split_gibbs.likelihood import RowLikelihood, point_materials
from pipeline.posterior.split_gibbs.setup import Model
from pipeline.posterior.split_gibbs.state import Randomness, State
from pipeline.posterior.textures import fill, splat
from pipeline.render.renderer import Explanation

# of the texture's side: roughness and metallic of the points run into each other over as much
SOFT = 64


def maps(rng: Randomness, model: Model, state: State, light: np.ndarray) -> dict[str, np.ndarray]:
    """Texture maps under the operator's light (M', 3): a drawn base colour per point spread over
    its texels; roughness and metallic by region, and how far points lie from that spread over their
    texels. Roughness is the material's own: what the normals' spread adds is left out.
    """
    data, materials, size = model.data, state.materials, model.settings.texture
    rows = RowLikelihood.of(model.mixer, state)
    _, _, colors = rows.draw_colors(light, rng.numpy)

    table = np.array(data.lobes.roughness)
    roughness, metallic = point_materials(data, materials, state.offsets)
    of_region = {"roughness": table[materials.roughness], "metallic": materials.metallic}
    beside = np.stack(
        [
            table[roughness] - of_region["roughness"][data.region],
            metallic - of_region["metallic"][data.region],
        ],
        1,
    )
    values = np.concatenate([colors, beside, np.ones((len(colors), 1))], 1)
    total = splat(model.uv, values[data.rows.point], size)
    known = total[..., 5] > 0.05
    spread = fill(total[..., :5] / np.maximum(total[..., 5:], 1e-6), known)

    base_color = cv2.GaussianBlur(spread[..., :3], (0, 0), 1.0)
    soft = cv2.GaussianBlur(spread[..., 3:], (0, 0), max(size / SOFT, 0.5))
    bounds = {"roughness": (table[0], table[-1]), "metallic": (0, 1)}
    out = {
        name: np.clip(of_region[name][model.region_map] + soft[..., k], *bounds[name])
        for k, name in enumerate(bounds)
    }
    out["base_color"] = np.clip(base_color, 0, 1)
    return {name: value.astype(np.float32) for name, value in out.items()}


def facts(model: Model, state: State) -> dict:
    """What sample.json says of a draw."""
    data, materials = model.data, state.materials
    roughness = data.lobes.roughness
    return {
        "scale": float(np.exp(state.log_scale)),
        "scale_drawn": True,
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
    """Step 6: the draw as an explanation, and its facts; `state.code` is a code of the diffusion
    prior.
    """
    decoder = model.decoder(model.prior)
    light = decoder.light(state.code, state.log_scale)
    drawn = maps(rng, model, state, light)
    env = decoder.map(state.code, state.log_scale)
    return replace(fit, light=env, **drawn), facts(model, state)
