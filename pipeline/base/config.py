"""A scene's configuration: one short YAML over a preset, validated once, here.

`load_scene(path)` merges field defaults < `configs/presets/<preset>.yaml` < the scene's own YAML.
Every field says its unit, range and reason. An unknown key is an error that names the nearest known
one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from pipeline.base.errors import InputError, nearest

PRESET_FOLDER = Path(__file__).resolve().parents[2] / "configs" / "presets"


MOST_PIXELS = 1_000_000  # of one step


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


SectionType = TypeVar("SectionType", bound=Section)


class Capture(Section):
    """Photos as linear light."""

    max_size: int = Field(
        1200, ge=64, le=8192, description="long side in pixels that later stages work at"
    )
    encoding: Literal["auto", "srgb", "linear"] = Field(
        "auto",
        description="auto: EXR is linear, everything else as its colour profile says, or sRGB; "
        "srgb and linear: read so, profiles ignored",
    )
    exposure: Literal["exif", "none"] = Field(
        "exif",
        description="exif: divide by exposure time x ISO / f-number^2, relative to the mean in log",
    )
    clip_fraction: float = Field(
        0.985, gt=0.5, le=1, description="fraction of full scale that counts as saturated"
    )
    leave_out: Literal["auto", "none"] = Field(
        "auto",
        description="auto: doubles of a burst, and blurred photos up to a fifth of all, are left "
        "out, unless cameras are given; none: every photo stays",
    )


class Poses(Section):
    """Cameras by structure from motion; ignored when cameras are given."""

    max_size: int = Field(
        1000, ge=200, le=4000, description="long side in pixels for features: 1600 brings no gain"
    )
    features: int = Field(4096, ge=500, le=32768, description="SIFT features per photo")
    matching: Literal["auto", "exhaustive", "sequential"] = Field(
        "auto",
        description="auto: exhaustive up to 60 photos, then sequential with quadratic overlap",
    )
    camera: Literal["auto", "single", "per_image"] = Field(
        "auto",
        description="auto: photos of one size (either way up) and one focal length share a camera",
    )
    min_registered: Annotated[float, Field(gt=0, le=1)] | Literal["auto"] = Field(
        "auto",
        description="below this share a second, more thorough attempt is made; auto: all of up to "
        "30 photos, 90 % of more",
    )
    match_exposure: bool = Field(
        True,
        description="divide out brightness and white balance that matched points show beyond EXIF, "
        "where they are much",
    )
    moving_light: Literal["refuse", "accept"] = Field(
        "refuse",
        description="what to do when the light moves with the camera (turntable, flash), which one "
        "distant light cannot explain: stop with the reason, or go on with a warning",
    )
    object_size: float | None = Field(
        None, gt=0, description="object's diameter in metres; none: unit-size asset"
    )
    up: Literal["auto", "none"] = Field(
        "auto", description="auto: turn the estimated gravity to +Y"
    )


class Masks(Section):
    """Which pixels show the object."""

    method: Literal["auto", "given", "plane", "onnx"] = Field(
        "auto", description="auto: given masks or alpha, else plane; onnx needs `onnx_model`"
    )
    parts: Literal["one", "all"] = Field(
        "one",
        description="plane: one: the connected thing on which the cameras' axes converge; all: "
        "everything that stands on the ground in the middle of the scene",
    )
    onnx_model: Path | None = Field(
        None, description="path of an installed ISNet-like network (1x3x1024x1024)"
    )

    @model_validator(mode="after")
    def _network_is_named(self) -> Masks:
        if self.method == "onnx" and self.onnx_model is None:
            raise ValueError("method is onnx, so onnx_model must name a network's file")
        return self


class Mesh(Section):
    """Surface from masks and photos; ignored when mesh.ply or mesh.obj is given."""

    method: Literal["auto", "hull", "fused"] = Field(
        "auto",
        description="auto: fused if depth maps agree and it predicts photos left out better than "
        "the hull does, else hull",
    )
    grid: int = Field(256, ge=48, le=512, description="cells along the longest side of the volume")
    faces: int = Field(30000, ge=200, le=500000, description="triangles after decimation, at most")
    face_error: float = Field(
        0.25,
        ge=0,
        le=10,
        description="photo pixels within which fewer triangles than `faces` must leave the surface "
        "at 95 % of what photos show; 0: as many as `faces`, which is also what a scene gets that "
        "sets `faces` itself or has choose.enabled false",
    )
    depth_pixels: int = Field(
        3_000_000,
        ge=50_000,
        le=100_000_000,
        description="object pixels over all photos that get a depth: bounds time on close-ups. "
        "Photos are reduced to have no more, and never enlarged",
    )
    min_agreement: float = Field(
        0.1, ge=0, le=1, description="share of pixels with agreeing depth below which hull alone"
    )
    refine_steps: int = Field(
        4,
        ge=0,
        le=100,
        description="photometric refinement: steps at half and at full scale, and again at full "
        "scale with the edges of given masks; 0: none",
    )
    plate: float = Field(
        8.0, gt=0, le=100, description="photometric refinement: stiffness against the photos' noise"
    )


class Atlas(Section):
    resolution: int = Field(
        1024, ge=16, le=8192, description="texels along a side that padding is made for"
    )
    padding: int = Field(4, ge=0, le=32, description="texels between charts")
    packer: Literal["xatlas", "tight"] = Field(
        "xatlas",
        description="who places the charts on the page; tight: Heliograph's own packer, whose page "
        "is fuller where charts are many or ragged",
    )
    normal_map: bool = Field(
        True, description="bake what decimation takes from the surface into a normal map"
    )


class Observe(Section):
    """Random pixels over all views."""

    pixels: int = Field(
        4_000_000,
        ge=256,
        le=20_000_000,
        description="pixels drawn over all fit views: those of forty photos of 1000 pixels a side",
    )
    held_out: float = Field(
        0.1,
        ge=0,
        lt=0.6,
        description="share of photos kept for scoring, of which no stage learns anything (at least "
        "1 from 8 on); 0: every photo is in the asset, which then has no score",
    )
    erode: float = Field(
        1.5, ge=0, le=20, description="pixels taken off the mask's edge: mixed with background"
    )
    ground: bool = Field(
        False,
        description="the ground near the object is geometry with the radiance that photos show, "
        "not distant light",
    )
    background: bool = Field(
        False, description="photos that look past the object show the light in those directions"
    )
    tint: bool = Field(
        True,
        description="what photos show around the object has about the light's tint; false for a "
        "coloured backdrop that fills them",
    )


class Choose(Section):
    """How much model the scene needs, from its data. `auto`: chosen, never above what is
    configured; `keep`: as configured. A scene that sets one of SETTINGS_OF itself keeps it, unless
    it asks for `auto` here.
    """

    enabled: bool = Field(True, description="decide at all; else every setting is as configured")
    texture: Literal["auto", "keep"] = Field(
        "auto", description="sides of the textures, by what a photo's pixel covers"
    )
    bounces: Literal["auto", "keep"] = Field(
        "auto", description="render.max_depth, by how much of its own sky the object hides"
    )
    light: Literal["auto", "keep"] = Field(
        "auto", description="sample.light, by how much the mesh's normal error blurs reflections"
    )
    fit: Literal["auto", "keep"] = Field(
        "auto", description="fit.texture, steps and pixels, by what a photo's pixel covers"
    )


SETTINGS_OF = {
    "texture": (("refine", "texture"), ("refine", "gloss_texture")),
    "bounces": (("render", "max_depth"),),
    "light": (("sample", "light"),),
    "fit": (("fit", "texture"), ("fit", "steps"), ("fit", "pixels")),
}  # what each decision of `Choose` sets


class Render(Section):
    """The forward model of fit, sample and refine."""

    max_depth: int = Field(
        8,
        ge=2,
        le=16,
        description="path vertices after the camera (Mitsuba's max_depth): "
        "8 = light after up to 7 surface interactions",
    )
    light_height: int = Field(
        32, ge=4, le=512, description="rows of the lat-long light; columns are twice that"
    )
    roughness_min: float = Field(
        0.08, ge=0.02, le=1, description="below this lobes are finer than the light's pixels"
    )


class Fit(Section):
    """Point estimate, Eq. 15 of DPI: Adam on light and materials together."""

    steps: int = Field(300, ge=1, le=100000)
    pixels: int = Field(8192, ge=16, le=MOST_PIXELS, description="pixels per step, over all views")
    spp: int = Field(
        4,
        ge=2,
        le=1024,
        multiple_of=2,
        description="paths per pixel and step; even: two independent halves",
    )
    learning_rate: float = Field(0.02, gt=0, le=1)
    texture: int = Field(256, ge=8, le=4096, description="texture side during the fit")


class Sample(Section):
    """Posterior samples of light and materials."""

    method: Literal[
        "split_gibbs",
        "gaussian",
        "dpi_paper",
        "dpi_code",
        "sds",
        "map",
        "global_norm",
        "total_variation",
        "chromaticity",
        "spherical_harmonics",
        "deep_image_prior",
        "direct_light",
        "split_sum",
        "gan_latent",
        "equivariant_field",
    ] = Field("split_gibbs", description="a key of pipeline.posterior.samplers.SAMPLERS")
    prior: str = Field(
        "prior_base", description="a file stem under weights/, or a path to .safetensors"
    )
    label: str | None = Field(
        None, description="class the prior is conditioned on; none: unconditional"
    )
    smooth: int = Field(
        8,
        ge=0,
        le=1000,
        description="split_gibbs: turns of decoupled annealing before the splitting",
    )
    levels: int = Field(
        3, ge=2, le=1000, description="split_gibbs: widths of the splitting from coarse to fine"
    )
    stay: int = Field(1, ge=0, le=10000, description="split_gibbs: turns at the finest width")
    points: int = Field(250, ge=20, le=20000, description="split_gibbs: surface points")
    views: int = Field(6, ge=1, le=100, description="split_gibbs: photos per point")
    light: int = Field(
        32,
        ge=4,
        le=128,
        description="split_gibbs: rows of the light in the operator; divides the prior's rows",
    )
    start_prior: str = Field(
        "gaussian_small", description="split_gibbs: Gaussian prior of the starts' lights"
    )
    start_points: int = Field(
        250, ge=10, description="split_gibbs: points that the starts' lights are fitted to"
    )
    region_steps: int = Field(
        100, ge=1, description="split_gibbs: Metropolis-Hastings steps of the materials per turn"
    )
    steps: int = Field(
        250, ge=2, le=1000, description="dpi: noise levels, a sub-sequence of T = 1000"
    )
    pixels: int = Field(4096, ge=16, le=MOST_PIXELS)
    spp: int = Field(4, ge=2, le=1024, multiple_of=2)
    guidance: float = Field(1.0, gt=0, le=100, description="multiplies the paper's rho schedule")
    learning_rate: float = Field(0.01, gt=0, le=1, description="materials' Adam step, Eq. 16")
    texture: int = Field(256, ge=8, le=4096)


class Refine(Section):
    """Materials (and one light scale) at full texture size with the light held, Eq. 17 of DPI."""

    steps: int = Field(
        40,
        ge=0,
        le=100000,
        description="Adam steps of roughness and metallic, where the sampler has not drawn them",
    )
    pixels: int = Field(4096, ge=16, le=MOST_PIXELS, description="pixels per step, over all views")
    spp: int = Field(4, ge=2, le=1024, multiple_of=2)
    learning_rate: float = Field(0.02, gt=0, le=1)
    shading_pixels: int = Field(
        1_000_000,
        ge=256,
        description="pixels that are path traced for the base colour; the others' shading is "
        "interpolated",
    )
    texel_paths: float = Field(
        12,
        ge=0,
        le=10_000,
        description="paths for every texel of the base colour besides, which find the light in "
        "details that the interpolation misses",
    )
    score_pixels: int = Field(
        24_000,
        ge=64,
        description="pixels of all held-out views together that are scored, spread over them, with "
        "the standard error that comes from that",
    )
    score_spp: int = Field(64, ge=2, le=4096, multiple_of=2, description="paths per scored pixel")
    texture: int = Field(1024, ge=16, le=8192, description="side of the exported textures")
    gloss_texture: int | None = Field(
        None, ge=16, le=8192, description="side of roughness and metallic; none: as `texture`"
    )
    gloss: Literal["maps", "tested"] = Field(
        "tested",
        description="tested: every body of the surface begins matt and keeps as much of the draw's "
        "gloss and metal as photos that were left out ask for; maps: all of both, as drawn",
    )


class Report(Section):
    relight_size: int = Field(
        320, ge=32, le=2048, description="half the width in pixels of the report's renders"
    )
    spp: int = Field(48, ge=2, le=4096, multiple_of=2, description="paths per pixel shown")


def _named(value: object) -> object:
    """ValueError for an empty path, which would be the project's own folder."""
    if value == "":
        raise ValueError("the name of the photos' folder is empty")
    return value


class Scene(Section):
    """One scene. `photos` is its folder (or a folder of images); relative paths start at the
    project's top folder.
    """

    photos: Annotated[Path, BeforeValidator(_named)]
    preset: Literal["draft", "standard", "reference"] = "standard"
    samples: Annotated[int, Field(ge=1, le=1000)] | Literal["auto"] = Field(
        3,
        description="posterior samples N; raising it only adds jobs. auto: three, and more until "
        "their mean base colour is known to .02 in sRGB",
    )
    most_samples: int = Field(12, ge=3, le=1000, description="of `samples: auto`")
    capture: Capture = Capture()
    poses: Poses = Poses()
    masks: Masks = Masks()
    mesh: Mesh = Mesh()
    atlas: Atlas = Atlas()
    observe: Observe = Observe()
    choose: Choose = Choose()
    render: Render = Render()
    fit: Fit = Fit()
    sample: Sample = Sample()
    refine: Refine = Refine()
    report: Report = Report()


# Settings of earlier versions, and what to do where a configuration has them
REMOVED = {
    "choose.maps": "remove the line: refine.gloss says whether gloss and metal are tested",
    "fit.seed": "remove the line: the fit always takes the same random numbers",
    "mesh.depth_scale": "remove the line: mesh.depth_pixels alone says how much photos are reduced",
    "observe.seed": "remove the line: photos that you name in transforms_test.json are held out, "
    "else always the same",
    "poses.seed": "remove the line: it changed nothing but the order of random tries",
    "sample.search_sweeps": "remove the line: there is no search any more",
    "sample.seed": "remove the line: sample k is drawn from seed k; raise `samples` for more draws",
}

# ValueError: bytes that are no text, a day that no calendar has; RecursionError: endless nesting
NOT_YAML = (yaml.YAMLError, ValueError, RecursionError)


def read_yaml(path: Path) -> dict:
    """A YAML mapping; anything else is an InputError."""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(
            "there is no such configuration", path, "write it: one line `photos: FOLDER` is enough"
        ) from error
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", path, "write a file there"
        ) from error
    except NOT_YAML as error:
        raise InputError(
            f"not valid YAML ({error})", path, "repair the line named above"
        ) from error
    if not isinstance(data, dict):
        raise InputError("expected `key: value` lines", path, "start with `photos: FOLDER`")
    return data


def merge(base: dict, over: dict) -> dict:
    """`over` on top of `base`, section by section."""
    out = dict(base)

    for key, value in over.items():
        both_are_sections = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = merge(out[key], value) if both_are_sections else value

    return out


def _explain(error: ValidationError, path: str | Path, model: Any) -> InputError:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] != "extra_forbidden":
        key = ".".join(_named_parts(first["loc"], model))
        return InputError(
            f"{key}: {first['msg']} (it is {first.get('input')!r})", path, f"correct {key}"
        )

    if key in REMOVED:
        return InputError(f"there is no setting '{key}' any more", path, REMOVED[key])

    for part in first["loc"][:-1]:
        model = model.model_fields[part].annotation
    return InputError(
        f"unknown key '{key}'", path, nearest(str(first["loc"][-1]), model.model_fields)
    )


def _named_parts(loc: tuple, model: Any) -> list[str]:
    """The parts of an error's place that stand in the configuration: behind a setting that may be
    of several types pydantic adds which of them it tried.
    """
    out = []
    for part in loc:
        field = getattr(model, "model_fields", {}).get(part)
        if field is None and not isinstance(part, int):
            break
        out.append(str(part))
        model = field.annotation if field is not None else None
    return out


def load_scene(path: str | Path, overrides: dict | None = None) -> Scene:
    """Read and validate configs/<scene>.yaml. Raises InputError naming file, key and cure."""
    path = Path(path)
    return parse_scene(merge(read_yaml(path), overrides or {}), path)


def parse_scene(own: dict, path: str | Path) -> Scene:
    """Merge a scene's mapping with its preset and validate."""
    preset = own.get("preset", "standard")
    known = {file.stem: file for file in PRESET_FOLDER.glob("*.yaml")}
    if not isinstance(preset, str) or preset not in known:
        raise InputError(f"unknown preset {preset!r}", path, nearest(str(preset), known))

    kept = merge(read_yaml(known[preset]), {"choose": settled(own)})
    if own_triangles(own):
        kept = merge(kept, {"mesh": {"face_error": 0}})
    return validated(Scene, merge(kept, own), path)


def own_triangles(own: dict) -> bool:
    """Whether a scene's mapping says itself how many triangles it wants, or wants no choices."""
    section = lambda name: own[name] if isinstance(own.get(name), dict) else {}
    return "faces" in section("mesh") or section("choose").get("enabled") is False


def settled(own: dict) -> dict[str, str]:
    """The decisions of `Choose` that a scene's mapping has taken itself, each as `keep`."""
    names = lambda section: own[section] if isinstance(own.get(section), dict) else {}
    return {
        decision: "keep"
        for decision, settings in SETTINGS_OF.items()
        if any(key in names(section) for section, key in settings)
    }


def validated(model: type[SectionType], values: dict, path: str | Path) -> SectionType:
    """An instance of `model`. Raises InputError naming file, key and cure."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _explain(error, path, model) from error


def slice_of(scene: Scene, *sections: str) -> dict:
    """The part of a configuration that a stage reads, as plain JSON values: Snakemake re-runs on
    its change only.
    """
    return scene.model_dump(mode="json", include=set(sections))


def configured(scene: Scene, decision: str) -> dict:
    """{section: {setting: value}} of what a decision may set, as configured."""
    values: dict = {}
    for section, key in SETTINGS_OF[decision]:
        values.setdefault(section, {})[key] = getattr(getattr(scene, section), key)
    return values
