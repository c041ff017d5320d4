"""Heliograph: photos in, relightable USD out.

snakemake --cores 2                                   every scene of configs/, its export and report
snakemake --cores 2 exports/garden.usda               one scene
snakemake --cores 2 exports/garden.usda --config preset=draft 'mesh={grid: 128}'

The samples are drawn by `split_gibbs` (posterior/split_gibbs/), unless `sample: {method: ...}` says
otherwise; the samplers of Diffusion Posterior Illumination are `dpi_paper` and `dpi_code`.

Files that a stage makes are flagged `update`: Snakemake then leaves the old ones in place until the
stage, which writes beside them, has replaced them (pipeline/base/files.py), and brings them back
when the job fails. That such a job is due nevertheless is noted by its command
(`stage_command` in pipeline/run/workflow.py).

`mem_mb` of a rule is at least one and a half times the largest peak that its stage had in benchmarks
(benchmarks/results/memory.json, work.json, scenes.json): for `snakemake --resources mem_mb=...` and
cluster executors.
"""

import sys
from pathlib import Path

from pipeline.base.enough import AUTO, FIRST, samples_wanted
from pipeline.base.errors import InputError
from pipeline.run.digest import code_digest
from pipeline.run.user import name_the_user
from pipeline.run.workflow import Scenes, stage_command

name_the_user()


def at_work():
    """Whether this process is to make results: no dry run, no drawing of the plan. Snakemake knows
    that from when it plans, not yet while it reads this file.
    """
    executes = workflow.executor_plugin is not None and not workflow.dryrun
    return workflow.is_main_process and executes


scenes = Scenes(config, exclusive=at_work)
WORK = "work/{wildcards.scene:q}"  # in shell commands; :q quotes the name
EXPLANATION = ["light.exr", "base_color.exr", "roughness.exr", "metallic.exr", "ior.json"]


def ask(function, *arguments):
    """A user's mistake as one plain message instead of a traceback."""
    try:
        return function(*arguments)
    except InputError as error:
        sys.exit(f"\nHeliograph cannot go on.\n  {error}")


def job_of(stage, wildcards):
    """Name of a job within its scene: the stage, and the sample's number where there is one."""
    return f"{stage}_{wildcards.sample}" if "sample" in wildcards.keys() else stage


def settings(stage, *sections):
    """Decide whether `stage` is due: its settings, its code, unfinished runs, damaged results."""
    return lambda w: (
        ask(scenes.slice, w.scene, *sections),
        code_digest(stage),
        ask(scenes.unfinished, w.scene, job_of(stage, w)),
    )


def scene_files(kind):
    """Input function for what a stage reads from the user's scene folder."""
    return lambda w: ask(getattr(scenes, kind), w.scene)


def made(folder, *names):
    """Output files of a stage, kept until the stage replaces them."""
    return [update(f"work/{{scene}}/{folder}/{name}") for name in names]


def command(stage, options, job=None):
    return stage_command(stage, job or stage, options, scenes.settings)


def first_refined(scene, count):
    """So many refined samples of a scene."""
    return [f"work/{scene}/refine/{k}/refine.json" for k in range(count)]


def refined(w):
    """The refined samples of a scene: as many as configured or, with `samples: auto`, as many as
    the stage `enough` asks for, which judges them again whenever there are more.
    """
    count = ask(scenes, w.scene).samples
    if count == AUTO:
        count, wanted = 0, FIRST
        while wanted > count:
            count, wanted = wanted, asked_for(w.scene, wanted)
    return first_refined(w.scene, count)


def asked_for(scene, count):
    """How many samples there shall be, judged by the first `count` of them. Snakemake does not mind
    that a file in the middle of the chain is missing as long as the files made from it are there,
    so one that was never made is forced.
    """
    file = f"work/{scene}/enough/{count - 1}/enough.json"
    if not Path(file).exists():
        workflow.dag.forcefiles.add(file)
    checkpoints.enough.get(scene=scene, sample=count - 1)
    return ask(samples_wanted, Path(file))


wildcard_constraints:
    scene=r"[^/]+",
    sample=r"\d+",


rule all:
    input:
        lambda w: [f"exports/{s}{end}" for s in scenes.known() for end in (".usda", "_report.html")],


rule capture:
    input:
        scene_files("photos"),
    output:
        made("capture", "capture.json", "photos.json", "radiance.json"),
    log:
        "work/{scene}/logs/capture.log",
    benchmark:
        "work/{scene}/benchmarks/capture.tsv"
    resources:
        mem_mb=2000,
    params:
        due=settings("capture", "photos", "capture"),
        order=lambda w: ask(scenes.order, w.scene),
    shell:
        command("capture", f"--out {WORK}/capture")


rule poses:
    input:
        rules.capture.output,
        scene_files("cameras"),
    output:
        made("poses", "poses.json", "cameras.json", "points.npz"),
    log:
        "work/{scene}/logs/poses.log",
    benchmark:
        "work/{scene}/benchmarks/poses.tsv"
    threads: 2
    resources:
        mem_mb=3000,
    params:
        due=lambda w: (settings("poses", "poses")(w), ask(scenes.held_out, w.scene)),
    shell:
        command("poses", f"--capture {WORK}/capture --out {WORK}/poses")


rule masks:
    input:
        rules.poses.output,
        scene_files("network"),
    output:
        made("masks", "masks.json", "given.json", "confidence.json", "overlay.jpg"),
    log:
        "work/{scene}/logs/masks.log",
    benchmark:
        "work/{scene}/benchmarks/masks.tsv"
    threads: 2
    resources:
        mem_mb=2000,
    params:
        due=settings("masks", "masks"),
    shell:
        command("masks", f"--poses {WORK}/poses --out {WORK}/masks")


rule mesh:
    input:
        rules.poses.output,
        rules.masks.output,
        scene_files("mesh"),
    output:
        made("mesh", "mesh.json", "mesh.ply", "surface.json", "preview.png"),
    log:
        "work/{scene}/logs/mesh.log",
    benchmark:
        "work/{scene}/benchmarks/mesh.tsv"
    threads: 2
    resources:
        mem_mb=4000,
    params:
        due=settings("mesh", "mesh"),
    shell:
        command("mesh", f"--poses {WORK}/poses --masks {WORK}/masks --out {WORK}/mesh")


rule atlas:
    input:
        rules.mesh.output,
    output:
        made("atlas", "atlas.json", "mesh_uv.ply", "atlas.png"),
    log:
        "work/{scene}/logs/atlas.log",
    benchmark:
        "work/{scene}/benchmarks/atlas.tsv"
    resources:
        mem_mb=2000,
    params:
        due=settings("atlas", "atlas"),
    shell:
        command("atlas", f"--mesh {WORK}/mesh --out {WORK}/atlas")


rule observe:
    input:
        rules.atlas.output,
        rules.mesh.output,
        rules.poses.output,
    output:
        made("observe", "observe.json", "observations.npz"),
    log:
        "work/{scene}/logs/observe.log",
    benchmark:
        "work/{scene}/benchmarks/observe.tsv"
    resources:
        mem_mb=2000,
    params:
        due=settings("observe", "observe", "poses"),
    shell:
        command(
            "observe",
            f"--poses {WORK}/poses --mesh {WORK}/mesh --atlas {WORK}/atlas --out {WORK}/observe",
        )


# What `load_problem` (pipeline/posterior/load.py) reads: inputs and options of fit, sample, refine.
PROBLEM = [
    "work/{scene}/observe/observe.json",
    "work/{scene}/observe/observations.npz",
    "work/{scene}/poses/cameras.json",
    "work/{scene}/atlas/mesh_uv.ply",
    "work/{scene}/mesh/surface.json",
]
PROBLEM_OPTIONS = " ".join(f"--{s} {WORK}/{s}" for s in ("observe", "poses", "atlas", "mesh"))


# How much model the scene needs; fit, sample, refine and report take the settings that it chose.
rule choose:
    input:
        PROBLEM,
    output:
        made("choose", "chosen.json", "choose.json"),
    log:
        "work/{scene}/logs/choose.log",
    benchmark:
        "work/{scene}/benchmarks/choose.tsv"
    resources:
        mem_mb=2000,
    params:
        due=lambda w: (settings("choose", "choose")(w), ask(scenes.choosable, w.scene)),
    shell:
        command("choose", f"{PROBLEM_OPTIONS} --out {WORK}/choose")


CHOSEN = "work/{scene}/choose/chosen.json"
CHOSEN_OPTION = f"--choose {WORK}/choose"


# Point estimate of light and materials, Eq. 15. One thread: sums of floats in any order would make
# every draw that begins there another.
rule fit:
    input:
        PROBLEM,
        CHOSEN,
    output:
        made("fit", "fit.json", *EXPLANATION),
    log:
        "work/{scene}/logs/fit.log",
    benchmark:
        "work/{scene}/benchmarks/fit.tsv"
    threads: 1
    resources:
        mem_mb=2000,
    params:
        due=settings("fit", "fit", "render"),
    shell:
        command("fit", f"{PROBLEM_OPTIONS} {CHOSEN_OPTION} --out {WORK}/fit")


# One posterior draw, by `split_gibbs` unless sample.method says otherwise (Eqs. 13, 16, 19 belong
# to dpi_paper and dpi_code). One thread, so that a draw is bit-identical anywhere.
rule sample:
    input:
        PROBLEM,
        CHOSEN,
        rules.fit.output,
        scene_files("priors"),
    output:
        made("sample/{sample}", "sample.json", "draw.json", *EXPLANATION),
    log:
        "work/{scene}/logs/sample_{sample}.log",
    benchmark:
        "work/{scene}/benchmarks/sample_{sample}.tsv"
    threads: 1
    resources:
        mem_mb=3500,
    params:
        due=settings("sample", "sample", "render"),
    shell:
        command(
            "sample",
            f"{PROBLEM_OPTIONS} {CHOSEN_OPTION} --fit {WORK}/fit --index {{wildcards.sample}} "
            f"--out {WORK}/sample/{{wildcards.sample}}",
            job="sample_{wildcards.sample}",
        )


# Materials at full texture size with the light held, Eq. 17.
rule refine:
    input:
        PROBLEM,
        CHOSEN,
        rules.sample.output,
    output:
        made("refine/{sample}", "refine.json", "left_out.npz", "seen.png", *EXPLANATION),
    log:
        "work/{scene}/logs/refine_{sample}.log",
    benchmark:
        "work/{scene}/benchmarks/refine_{sample}.tsv"
    resources:
        mem_mb=6500,
    params:
        due=settings("refine", "refine", "render", "observe"),
    shell:
        command(
            "refine",
            f"{PROBLEM_OPTIONS} {CHOSEN_OPTION} --sample {WORK}/sample/{{wildcards.sample}} "
            f"--index {{wildcards.sample}} --out {WORK}/refine/{{wildcards.sample}}",
            job="refine_{wildcards.sample}",
        )


# Whether samples 0 to {sample} are enough: with `samples: auto` alone, again after every doubling.
checkpoint enough:
    input:
        lambda w: first_refined(w.scene, int(w.sample) + 1),
    output:
        made("enough/{sample}", "enough.json"),
    log:
        "work/{scene}/logs/enough_{sample}.log",
    benchmark:
        "work/{scene}/benchmarks/enough_{sample}.tsv"
    resources:
        mem_mb=2000,
    params:
        due=settings("enough", "most_samples"),
    shell:
        command(
            "enough",
            f"--refine {WORK}/refine --index {{wildcards.sample}} "
            f"--out {WORK}/enough/{{wildcards.sample}}",
            job="enough_{wildcards.sample}",
        )


rule export:
    input:
        "work/{scene}/atlas/mesh_uv.ply",
        "work/{scene}/poses/cameras.json",
        "work/{scene}/capture/radiance.json",
        samples=refined,
    output:
        update("exports/{scene}.usda"),
        update("exports/{scene}/sample_0.usda"),
        update("work/{scene}/export.json"),
    log:
        "work/{scene}/logs/export.log",
    benchmark:
        "work/{scene}/benchmarks/export.tsv"
    resources:
        mem_mb=2000,
    params:
        due=settings("export", "samples", "preset", "sample"),
        folders=lambda w, input: [str(Path(i).parent) for i in input.samples],
    shell:
        command(
            "export",
            f"--atlas {WORK}/atlas --capture {WORK}/capture --poses {WORK}/poses "
            "--samples {params.folders:q} "
            f"--metrics {WORK}/export.json --out exports/{{wildcards.scene:q}}.usda",
        )


rule report:
    input:
        rules.export.output,
    output:
        update("exports/{scene}_report.html"),
        update("work/{scene}/report.json"),
    log:
        "work/{scene}/logs/report.log",
    benchmark:
        "work/{scene}/benchmarks/report.tsv"
    threads: 2
    resources:
        mem_mb=3000,
    params:
        due=settings("report", "samples", "preset", "report", "render", "refine", "observe"),
    shell:
        command(
            "report",
            f"--work {WORK} --usd exports/{{wildcards.scene:q}}.usda "
            "--out exports/{wildcards.scene:q}_report.html",
        )
