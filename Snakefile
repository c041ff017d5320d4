"""Heliograph: photos in, relightable USD out. `snakemake --cores 2 exports/garden.usda [--config preset=draft]`"""
import sys
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.run.workflow import Scenes, code_digest, only_one_run

scenes = Scenes(config)
SET = " ".join(f"--set {s!r}" for s in scenes.settings)
W = "work/{scene}/"
FOLDERS = "--observe work/{wildcards.scene}/observe --poses work/{wildcards.scene}/poses --atlas work/{wildcards.scene}/atlas "
LIBRARY = f"OMP_NUM_THREADS={{threads}} {sys.executable!r} -m stages."

if workflow.is_main_process and not workflow.dryrun:
    LOCK = only_one_run(Path("work/.running"))


def ask(function, *arguments):
    """A user's mistake as one plain message instead of a traceback."""
    try:
        return function(*arguments)
    except InputError as error:
        sys.exit(f"\nHeliograph cannot go on.\n  {error}")


def settings(stage, *sections):
    """Parameters that decide whether `stage` is out of date: its slice of the configuration and its code."""
    return lambda w: ask(scenes.slice, w.scene, *sections) + code_digest(stage)


def scene_files(kind):
    """Input function for what a stage reads from the user's scene folder."""
    return lambda w: ask(getattr(scenes, kind), w.scene)


def command(stage, options):
    """The shell command of a stage: its log keeps everything, the terminal sees the progress."""
    return f"{LIBRARY}{stage} --config configs/{{wildcards.scene}}.yaml {SET} --threads {{threads}} {options} 2>&1 | tee {{log}}"


def refined(w):
    """The refined samples of a scene."""
    return [f"work/{w.scene}/refine/{k}/refine.json" for k in range(ask(scenes, w.scene).samples)]


wildcard_constraints:
    scene=r"[^/]+",
    sample=r"\d+",


rule capture:
    input: scene_files("photos")
    output: W + "capture/capture.json"
    params: settings("capture", "photos", "capture")
    log: W + "logs/capture.log"
    benchmark: W + "benchmarks/capture.tsv"
    shell:
        command("capture", "--out work/{wildcards.scene}/capture")

rule poses:
    input: rules.capture.output, scene_files("cameras")
    output: W + "poses/poses.json"
    params: settings("poses", "poses")
    threads: 2
    log: W + "logs/poses.log"
    benchmark: W + "benchmarks/poses.tsv"
    shell:
        command("poses", "--capture work/{wildcards.scene}/capture --out work/{wildcards.scene}/poses")

rule masks:
    input: rules.poses.output
    output: W + "masks/masks.json"
    params: settings("masks", "masks")
    threads: 2
    log: W + "logs/masks.log"
    benchmark: W + "benchmarks/masks.tsv"
    shell:
        command("masks", "--poses work/{wildcards.scene}/poses --out work/{wildcards.scene}/masks")

rule mesh:
    input: rules.poses.output, rules.masks.output, scene_files("mesh")
    output: W + "mesh/mesh.json"
    params: settings("mesh", "mesh")
    threads: 2
    log: W + "logs/mesh.log"
    benchmark: W + "benchmarks/mesh.tsv"
    shell:
        command("mesh", "--poses work/{wildcards.scene}/poses --masks work/{wildcards.scene}/masks --out work/{wildcards.scene}/mesh")

rule atlas:
    input: rules.mesh.output
    output: W + "atlas/atlas.json"
    params: settings("atlas", "atlas")
    log: W + "logs/atlas.log"
    benchmark: W + "benchmarks/atlas.tsv"
    shell:
        command("atlas", "--mesh work/{wildcards.scene}/mesh --out work/{wildcards.scene}/atlas")

rule observe:
    input: rules.atlas.output, rules.mesh.output, rules.poses.output
    output: W + "observe/observe.json"
    params: settings("observe", "observe")
    log: W + "logs/observe.log"
    benchmark: W + "benchmarks/observe.tsv"
    shell:
        command("observe", "--poses work/{wildcards.scene}/poses --mesh work/{wildcards.scene}/mesh --atlas work/{wildcards.scene}/atlas "
        "--out work/{wildcards.scene}/observe")

rule fit:
    # point estimate of light and materials, Eq. 15
    input: rules.observe.output
    output: W + "fit/fit.json"
    params: settings("fit", "fit", "render")
    threads: 2
    log: W + "logs/fit.log"
    benchmark: W + "benchmarks/fit.tsv"
    shell:
        command("fit", FOLDERS + "--out work/{wildcards.scene}/fit")

rule sample:
    # one posterior draw, Eqs. 13, 16, 19; one thread, so that it is bit-identical anywhere
    input: rules.fit.output
    output: W + "sample/{sample}/sample.json"
    params: settings("sample", "sample", "render")
    log: W + "logs/sample_{sample}.log"
    benchmark: W + "benchmarks/sample_{sample}.tsv"
    shell:
        command("sample", FOLDERS + "--fit work/{wildcards.scene}/fit --index {wildcards.sample} --out work/{wildcards.scene}/sample/{wildcards.sample}")

rule refine:
    # materials at full texture size, Eq. 17
    input: rules.sample.output
    output: W + "refine/{sample}/refine.json"
    params: settings("refine", "refine", "render", "observe", "report")
    log: W + "logs/refine_{sample}.log"
    benchmark: W + "benchmarks/refine_{sample}.tsv"
    shell:
        command("refine", FOLDERS + "--mesh work/{wildcards.scene}/mesh --sample work/{wildcards.scene}/sample/{wildcards.sample} "
                                   "--index {wildcards.sample} --out work/{wildcards.scene}/refine/{wildcards.sample}")

rule export:
    input: refined
    output: "exports/{scene}.usda"
    params: settings("export", "samples", "preset", "sample"), folders=lambda w, input: [str(Path(i).parent) for i in input]
    log: W + "logs/export.log"
    benchmark: W + "benchmarks/export.tsv"
    shell:
        command("export", "--atlas work/{wildcards.scene}/atlas --poses work/{wildcards.scene}/poses --samples {params.folders} "
                         "--metrics work/{wildcards.scene}/export.json --out exports/{wildcards.scene}.usda")

rule report:
    input: rules.export.output
    output: "exports/{scene}_report.html"
    params: settings("report", "samples", "preset", "report", "render")
    threads: 2
    log: W + "logs/report.log"
    benchmark: W + "benchmarks/report.tsv"
    shell:
        command("report", "--work work/{wildcards.scene} --usd exports/{wildcards.scene}.usda --out exports/{wildcards.scene}_report.html")
