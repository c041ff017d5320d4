"""METHODS: what the study compares, by name."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from benchmarks.suite.lights import LABELS
from pipeline.base.config import PRESET_FOLDER, Scene, merge, parse_scene, read_yaml
from pipeline.base.errors import InputError, nearest
from pipeline.posterior.samplers import SAMPLERS

OURS = "split_gibbs_draft"  # what others are compared with
TEXTURE = 256  # side of every method's refined maps
MEANT = 3  # draws that a mean is made of


@dataclass(frozen=True)
class Method:
    """sampler: a key of SAMPLERS; preset: whose section `sample` it has; settings: on top of it;
    drawn: False for a method that finds one optimum and gets one row a scene: what its seeds differ
    by is noise of pixels and paths, no uncertainty; labelled: it is told whether the light is an
    indoor one, as its authors do; shipped: all of it is the preset's, as users get it; mean_of: the
    method whose first MEANT draws' mean it is, the same in all else (`mean`); it draws nothing.
    """

    sampler: str
    preset: str = "draft"
    settings: dict = field(default_factory=dict)
    drawn: bool = True
    labelled: bool = False
    shipped: bool = False
    mean_of: str | None = None


PRESETS = {
    "preset_draft": Method("split_gibbs", "draft", shipped=True),
    "preset_standard": Method("split_gibbs", "standard", shipped=True),
}
DRAFT = {OURS: Method("split_gibbs", "draft")}


def means(methods: dict[str, Method]) -> dict[str, Method]:
    """Of each method the mean of its draws, as an asset opens with it."""
    return {f"{k}_mean": replace(m, mean_of=k, drawn=False) for k, m in methods.items()}


METHODS = {
    **PRESETS,
    **means(PRESETS),
    **DRAFT,
    **means(DRAFT),
    "split_gibbs_standard": Method("split_gibbs", "standard"),
    "split_gibbs_reference": Method("split_gibbs", "reference"),
    "gaussian": Method("gaussian"),
    "map": Method("map", drawn=False),
    "global_norm": Method("global_norm", drawn=False),
    "total_variation": Method("total_variation", drawn=False),
    "chromaticity": Method("chromaticity", drawn=False),
    "spherical_harmonics": Method("spherical_harmonics", drawn=False),
    "deep_image_prior": Method("deep_image_prior", drawn=False),
    "direct_light": Method("direct_light", drawn=False),
    "split_sum": Method("split_sum", drawn=False),
    "gan_latent": Method("gan_latent", drawn=False),
    "equivariant_field": Method("equivariant_field", drawn=False),
    "sds": Method("sds"),
    "dpi_paper": Method("dpi_paper"),
    "dpi_paper_10": Method("dpi_paper", settings={"steps": 10}),
    "dpi_paper_30": Method("dpi_paper", settings={"steps": 30}),
    "dpi_paper_300": Method("dpi_paper", settings={"steps": 300}),
    "dpi_paper_1000": Method("dpi_paper", settings={"steps": 1000}),
    "dpi_code": Method("dpi_code", labelled=True),
    "dpi_code_1000": Method("dpi_code", settings={"steps": 1000}, labelled=True),
}
# a sampler's runs of growing length, whose quality a chart follows against their time
LENGTHS = {
    "preset": ("preset_draft", "preset_standard"),
    "preset_mean": ("preset_draft_mean", "preset_standard_mean"),
    "split_gibbs": tuple(f"split_gibbs_{preset}" for preset in ("draft", "standard", "reference")),
    "dpi_paper": ("dpi_paper_10", "dpi_paper_30", "dpi_paper", "dpi_paper_300", "dpi_paper_1000"),
    "dpi_code": ("dpi_code", "dpi_code_1000"),
}
# what every method has to beat (benchmarks/study/yardsticks.py)
YARDSTICKS = ("unlit", "unlit_scaled", "diffuse")
assert {method.sampler for method in METHODS.values()} == set(SAMPLERS)


def is_ours(name: str) -> bool:
    """Whether a row, a method's or a yardstick's, is of this project's own sampler."""
    return name in METHODS and METHODS[name].sampler == "split_gibbs"


def keeps_draws(name: str) -> bool:
    """Whether a mean is made of the method's draws."""
    return any(method.mean_of == name for method in METHODS.values())


def methods_named(names: list[str]) -> list[str]:
    """The names, where all are known. Raises InputError."""
    for name in names:
        if name not in METHODS:
            raise InputError(f"there is no method '{name}'", "--methods", nearest(name, METHODS))
    return names


def scene_for(name: str, photos: str) -> Scene:
    """The configuration of a method's draws of a scene. All share the stages before, of the preset
    draft; refinement is the base colour in closed form, so that each method's own roughness and
    metallic are judged. Of a shipped preset nothing is changed.
    """
    method = METHODS[name]
    if method.shipped:
        return parse_scene({"photos": photos, "preset": method.preset}, "benchmarks.study")

    label = LABELS.get(photos.rpartition("__")[2].partition("_")[0])
    told = {"label": label} if method.labelled else {}
    sample = read_yaml(PRESET_FOLDER / f"{method.preset}.yaml").get("sample", {})
    standard = Scene(photos=photos).sample.model_dump()
    sample = merge(standard, merge(sample, {"method": method.sampler, **method.settings, **told}))
    own = {
        "photos": photos,
        "preset": "draft",
        "sample": sample,
        "refine": {"steps": 0, "texture": TEXTURE, "gloss": "maps"},
    }
    return parse_scene(own, "benchmarks.study")
