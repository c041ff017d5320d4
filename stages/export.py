"""Export: exports/<scene>.usda with one variant per sample, flat files beside it, checked by the
USD validators.
"""

import argparse
from pathlib import Path

from pipeline.base.files import report_metrics
from pipeline.base.manifest import NAME, write_manifest
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.geometry.cameras import load_cameras
    from pipeline.photos.radiance import Radiance
    from pipeline.render.samples import Samples, Spread, asset_facts
    from pipeline.usd.write import export

    facts = {
        "preset": s.scene.preset,
        "sampler": s.scene.sample.method,
        "prior": s.scene.sample.prior,
        "poses": load_cameras(s.args.poses / "cameras.json").source,
        "meters_known": s.scene.poses.object_size is not None,
    }
    samples = Samples(s.args.samples)
    facts |= asset_facts(Spread.of(samples), samples.texels)
    white = Radiance.load(s.args.capture).white
    metrics = export(s.args.atlas, s.args.samples, s.out, facts, white)
    report_metrics(s.args.metrics, metrics | s.costs())

    made = [s.args.metrics, s.out, s.out.with_suffix(".usdz"), *s.out.with_suffix("").rglob("*")]
    noted = s.args.metrics.with_name(f".export{NAME}")
    write_manifest(noted, [file for file in made if file.is_file()])


def more(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--samples",
        type=Path,
        nargs="+",
        required=True,
        help="folders of refined samples, in order",
    )
    parser.add_argument(
        "--metrics", type=Path, required=True, help="JSON file for this stage's metrics"
    )


if __name__ == "__main__":
    stage(
        __doc__,
        {
            "atlas": "folder of the atlas stage",
            "capture": "folder of the capture stage (the photos' unit of radiance)",
            "poses": "folder of the poses stage",
        },
        work,
        more,
    )
