"""What was chosen of the model, and on which evidence, in plain words: a table."""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple


class Choice(NamedTuple):
    """A row of the table: of what, what was chosen, and why."""

    what: str
    chosen: str
    why: str


def triangles_choice(found: dict) -> list[Choice]:
    """Of a surface that was made from photos and decimated by what these tell; else nothing."""
    attempts = found.get("attempts")
    if not attempts:
        return []
    within = [a for a in attempts if a[1] <= found["tolerance"]]
    faces, apart = (within or attempts)[-1]
    too_far = "" if within == attempts else f"; with {attempts[-1][0]} it is {attempts[-1][1]:.2f}"
    why = f"the surface lies within {apart:.2f} pixels of the dense one{too_far if within else ''}"
    return [Choice("triangles", f"{faces} of {found['most']}", why)]


def texture_choice(decision: dict) -> Choice:
    sides, was = decision["chosen"]["refine"], decision["configured"]["refine"]
    texels = decision["evidence"]["texels_for_one_each_pixel"]
    return Choice(
        "textures",
        f"{sides['texture']} of {was['texture']} texels a side, {sides['gloss_texture']} where "
        "roughness and metallic are textures",
        f"at {texels:.0f} a texel is as large as what the median pixel shows",
    )


def bounces_choice(decision: dict) -> Choice:
    depth, most = (decision[k]["render"]["max_depth"] for k in ("chosen", "configured"))
    evidence = decision["evidence"]
    blocked = evidence["hemisphere_blocked_by_the_object"]["mean"]
    lost = evidence["lost_share_by_max_depth"][str(depth)]
    return Choice(
        "surface interactions of light",
        f"{depth - 1} of {most - 1}",
        f"the object hides {100 * blocked:.1f} % of its own sky, and what is left out is "
        f"{100 * lost:.1f} % of the light",
    )


def light_choice(decision: dict) -> Choice:
    rows, most = (decision[k]["sample"]["light"] for k in ("chosen", "configured"))
    needed = decision["evidence"]["rows_told_apart"]
    if needed is None:
        why = "the surface was given, without an error"
    else:
        why = (
            "normals in error blur reflections so much that "
            f"{needed:.0f} rows hold all that can be seen"
        )
    return Choice("rows of the light", f"{rows} of {most}", why)


def fit_choice(decision: dict) -> Choice:
    work, was = decision["chosen"]["fit"], decision["configured"]["fit"]
    return Choice(
        "the fit",
        f"{work['steps']} of {was['steps']} steps, {work['pixels']} of {was['pixels']} pixels, "
        f"{work['texture']} of {was['texture']} texels a side",
        f"every texel is looked at {decision['evidence']['looks_at_a_texel']:.0f} times",
    )


def samples_choice(found: dict) -> list[Choice]:
    """How many samples there are, where that was left open; else nothing."""
    if not found:
        return []
    drawn, needed = found["drawn"], found["needed"]
    why = (
        f"their base colours differ by {found['spread']:.3f} (sRGB, root mean square), so {needed} "
        f"give a mean that is known to {found['known_to']:.2f}"
    )
    chosen = f"{drawn}, as many as allowed" if needed > drawn else str(drawn)
    return [Choice("samples", chosen, why)]


DECISIONS = {
    "texture": texture_choice,
    "bounces": bounces_choice,
    "light": light_choice,
    "fit": fit_choice,
}


def why_of(body: dict, rungs: list[str]) -> str:
    """Why a body of a sample has its rung: by what share the step up to it, or the best of those
    that it did not take, makes the error of photos that were left out smaller.
    """
    if not body["tried"]:
        return "nothing else was tried"
    taken = [step for step in body["tried"] if rungs[step["to"]] == body["chosen"]]
    best = max(body["tried"], key=lambda step: step["gain"] - 2 * step["standard_error"])
    step = taken[-1] if taken else best
    sure = shares_of(step)
    if taken:
        return f"it saves {sure} of the error of {rungs[step['from']]}"
    if step["gain"] <= 0:
        return "nothing else predicts better"
    return f"{rungs[step['to']]} would save {sure} of the error: too little to be sure"


def gloss_choices(sample: str, found: dict) -> list[Choice]:
    """Of one sample: its surface as a whole, then its bodies of one colour, those together that
    were judged alike.
    """
    what = f"gloss and metal of sample {sample}"
    if "why" in found:
        return [Choice(what, "maps, as drawn", found["why"])]
    rungs, surface = found["rungs"], found["surface"]
    judged = f"judged by {found['blocks']} blocks of {found['photos_left_out']} photos left out"
    out = [Choice(what, surface["chosen"], f"{why_of(surface, rungs)}; {judged}")]

    alike = defaultdict(list)
    for body in found["bodies"]:
        if body["share"]:
            alike[body["chosen"], why_of(body, rungs)].append(body["share"])
    for (chosen, why), shares in alike.items():
        bodies = "a body" if len(shares) == 1 else f"{len(shares)} bodies"
        out.append(Choice(f"{bodies} of it, {100 * sum(shares):.0f} %", chosen, why))
    return out + bare_choice(sample, found.get("no highlight"))


def bare_choice(sample: str, tried: dict | None) -> list[Choice]:
    """Whether a sample goes without any highlight, where that was tried."""
    if tried is None:
        return []
    what, sure = f"highlight of sample {sample}", shares_of(tried)
    if tried["chosen"]:
        why = f"to have none saves {sure} of the error of the above"
        return [Choice(what, "none, in place of the above", why)]
    return [Choice(what, "as above", "without any it predicts no better")]


def shares_of(step: dict) -> str:
    """The gain of a step in words, with its standard error."""
    return f"{100 * step['gain']:.1f} % ± {100 * step['standard_error']:.1f}"


def choices(facts: dict[str, dict]) -> list[Choice]:
    """Every decision that was taken. facts: stage -> its metrics."""
    decisions = facts["choose"]["decisions"]
    taken = {name: decisions[name] for name in DECISIONS if "chosen" in decisions.get(name, {})}
    out = triangles_choice(facts["mesh"].get("triangles", {}))
    out += [DECISIONS[name](decision) for name, decision in taken.items()]
    for stage, fact in facts.items():
        if stage.startswith("refine") and fact.get("gloss"):
            out += gloss_choices(stage.split()[1], fact["gloss"])
    return out + samples_choice(facts.get("enough", {}))
