"""What was chosen of the model, and on which evidence, in plain words."""

from __future__ import annotations


def texture_words(decision: dict) -> str:
    sides, was = decision["chosen"]["refine"], decision["configured"]["refine"]
    texels = decision["evidence"]["texels_for_one_each_pixel"]
    return (
        f"Textures have {sides['texture']} texels a side, {was['texture']} were allowed: at "
        f"{texels:.0f} a texel is as large as what the median pixel shows. Roughness and metallic "
        f"have {sides['gloss_texture']} where they are textures."
    )


def bounces_words(decision: dict) -> str:
    depth, most = (decision[k]["render"]["max_depth"] for k in ("chosen", "configured"))
    evidence = decision["evidence"]
    blocked = evidence["hemisphere_blocked_by_the_object"]["mean"]
    lost = evidence["lost_share_by_max_depth"][str(depth)]
    return (
        f"Light is followed over {depth - 1} surface interactions, {most - 1} were allowed: the "
        f"object hides {100 * blocked:.1f} % of its own sky, and what is left out is "
        f"{100 * lost:.1f} % of the light."
    )


def light_words(decision: dict) -> str:
    rows, most = (decision[k]["sample"]["light"] for k in ("chosen", "configured"))
    needed = decision["evidence"]["rows_told_apart"]
    if needed is None:
        return f"The light keeps its {most} rows: the surface was given, without an error."
    return (
        f"The light has {rows} rows, {most} were allowed: normals in error blur reflections so "
        f"much that {needed:.0f} rows hold all that can be seen."
    )


def fit_words(decision: dict) -> str:
    work, was = decision["chosen"]["fit"], decision["configured"]["fit"]
    return (
        f"The fit has {work['steps']} steps of {work['pixels']} pixels and {work['texture']} "
        f"texels a side, {was['steps']}, {was['pixels']} and {was['texture']} were allowed: every "
        f"texel is looked at {decision['evidence']['looks_at_a_texel']:.0f} times."
    )


WORDS = {
    "texture": texture_words,
    "bounces": bounces_words,
    "light": light_words,
    "fit": fit_words,
}


def body_words(body: dict, rungs: list[str]) -> str:
    """One body of one sample: its rung, and by what share the step up to it, or the best of those
    that it did not take, makes the error of photos that were left out smaller.
    """
    words = f"{100 * body['share']:.0f} % {body['chosen']}"
    if not body["tried"]:
        return words
    taken = [step for step in body["tried"] if rungs[step["to"]] == body["chosen"]]
    best = max(body["tried"], key=lambda step: step["gain"] - 2 * step["standard_error"])
    step = taken[-1] if taken else best
    sure = f"{100 * step['gain']:+.1f} % ± {100 * step['standard_error']:.1f}"
    if taken:
        return f"{words} ({sure} of the error of {rungs[step['from']]})"
    if step["gain"] <= 0:
        return f"{words} (none predicts better)"
    return f"{words} ({rungs[step['to']]} would save {sure} of the error: too little to be sure)"


def choices(facts: dict[str, dict]) -> list[str]:
    """Sentences on every decision that was taken. facts: stage -> its metrics."""
    decisions = facts["choose"]["decisions"]
    out = [
        words(decisions[name])
        for name, words in WORDS.items()
        if "chosen" in decisions.get(name, {})
    ]
    for stage, fact in facts.items():
        found = fact.get("gloss", {}) if stage.startswith("refine") else {}
        if "why" in found:
            out.append(f"Sample {stage.split()[1]}: {found['why']}.")
        elif found:
            said = [body_words(body, found["rungs"]) for body in found["bodies"] if body["share"]]
            out.append(
                f"Gloss and metal of sample {stage.split()[1]}, judged by {found['blocks']} blocks "
                f"of {found['photos_left_out']} photos that were left out: the surface as a whole "
                f"{found['surface']['chosen']}; its bodies of one colour {'; '.join(said)}."
            )
    return out
