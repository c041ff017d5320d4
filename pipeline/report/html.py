"""The report's page: `page.html` and `page.css` beside this file, filled in by Jinja2. Pictures are
inlined; the one script is the viewer's (viewer.js), and there is no outside address.
"""

from __future__ import annotations

from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from pipeline.base.config import Scene
from pipeline.report.choices import choices
from pipeline.report.pictures import data_address

HULL = (
    "the surface is the hull of the masks' outlines: hollows that no outline shows are filled, and "
    "light and materials are estimated on what fills them. Photographs from more sides and heights "
    "cut it closer; where the object may be dusted with matt powder, a given mesh made of such "
    "photographs is better"
)


def warnings(facts: dict[str, dict]) -> list[str]:
    """What went wrong, in plain words: the stages' own warnings, and what their metrics show."""
    out = [f"{stage}: {text}" for stage, fact in facts.items() for text in fact.get("warnings", [])]

    lost = facts["poses"].get("unregistered") or []
    if lost:
        out.append(
            f"poses: {len(lost)} of {facts['poses']['photos']} photos could not be placed and are "
            f"not used: {', '.join(lost[:10])}"
        )

    clipped = facts["capture"].get("clipped_share", 0)
    if clipped > 0.02:
        out.append(
            f"capture: {100 * clipped:.0f} % of the pixels are saturated; there the photos only "
            'say "at least this bright"'
        )

    if facts["mesh"]["method"] == "hull":
        out.append(f"mesh: {HULL}")

    bare = facts["mesh"].get("mask_share_without_surface", 0)
    if bare > 0.03:
        out.append(
            f"mesh: {100 * bare:.0f} % of the masks' pixels show no surface of the object (mostly "
            "ground, where masks were made); the final masks leave out what was not given"
        )
    return out


def tint_from(scene: Scene, observed: dict) -> str:
    """Where the light's tint is known from, by the settings and the facts of the observe stage."""
    alone = "from the object alone"
    if scene.sample.method not in ("split_gibbs", "gaussian") or not scene.observe.tint:
        return alone
    found = observed.get("tint_around", observed.get("surroundings"))
    if isinstance(found, list):
        return "from what the photos show around the object"
    return f"{alone}: {found.removeprefix('none: ')}" if found else alone


def summary(scene: Scene, facts: dict[str, dict], mean: dict | None) -> list[tuple[str, str]]:
    """(name, value) of the figures at the top."""
    seconds = sum(fact.get("seconds", 0) for fact in facts.values())
    refined = [fact for stage, fact in facts.items() if stage.startswith("refine")]
    scores = [f["held_out_psnr"] for f in refined if f.get("held_out_psnr") is not None]

    out = [
        ("preset", scene.preset),
        ("samples", str(facts["export"]["samples"])),
        ("photos placed", f"{facts['poses']['registered']} of {facts['poses']['photos']}"),
    ]
    if scores:
        score = f"{sum(scores) / len(scores):.1f} dB PSNR a sample"
        if mean and mean["held_out"] is not None:
            score += f", {mean['held_out']:.1f} their mean"
    elif facts["observe"]["held_out"]:
        score = "none shows the object"
    else:
        score = "none was held out: every photo is in the asset"
    out.append(("held-out views", score))
    out.append(("surface", facts["mesh"]["method"]))
    out.append(("colour of the light", tint_from(scene, facts["observe"])))
    out.append(("sum of stage times", f"{seconds / 60:.1f} min"))
    return out


def page(
    usd: Path,
    scene: Scene,
    facts: dict[str, dict],
    pictures: dict,
    samples: list[dict],
    mean: dict | None,
    view: str,
    held: bool,
    said: dict,
) -> str:
    """The whole page as one string.

    facts: stage -> its metrics; pictures, samples, mean: encoded pictures of `pictures.Painter`,
    the mean's with its score on held-out photos, None for one sample; view: name of the photo that
    is shown; held: whether no fit has seen it. said: `trust`, sentences on
    how far the asset may be relied on; `enough`, whether there are samples enough, `counts`, how
    much each counts in the mean, and `within`, how far base colours may be off, all three empty for
    one sample; `unseen`, how much of the surface no photo shows, empty for hardly any; `alike`,
    that one roughness of all samples is a choice, empty where they differ; `files`, what
    `asset_files` gives; `viewer`, what `viewer_data` does, None where the mesh is too large for it.
    """
    environment = Environment(
        loader=PackageLoader("pipeline.report", ""), autoescape=True, undefined=StrictUndefined
    )
    environment.filters["data_address"] = data_address
    return environment.get_template("page.html").render(
        usd=usd,
        facts=facts,
        summary=summary(scene, facts, mean),
        warnings=warnings(facts),
        choices=choices(facts),
        pictures=pictures,
        samples=samples,
        mean=mean,
        **said,
        view=view,
        kind="held out: no fit has seen it" if held else "used in the fit",
    )
