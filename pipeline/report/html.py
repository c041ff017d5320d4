"""The report's page: plain HTML and CSS, pictures inlined, no outside address."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path

from pipeline.base.config import Scene

STYLE = """
:root{color-scheme:light dark;--bg:#f6f5f2;--card:#fff;--ink:#1d1f23;--soft:#62666e;--line:#dcdad4;--accent:#b4540a}
@media(prefers-color-scheme:dark){:root{--bg:#15171a;--card:#1e2125;--ink:#ececea;--soft:#9aa0a8;--line:#33373d;--accent:#f0a050}}
*{box-sizing:border-box}body{margin:0;background:var(--bg);color:var(--ink);font:16px/1.5 system-ui,sans-serif}
main{max-width:1180px;margin:0 auto;padding:24px 16px 64px}h1{font-size:1.7rem;margin:.2em 0}h2{margin:2em 0 .5em;font-size:1.2rem}
p,li{max-width:75ch}.soft,figcaption,td.soft{color:var(--soft)}img{width:100%;height:auto;display:block;border-radius:6px;background:#000}
.facts{display:flex;flex-wrap:wrap;gap:10px;padding:0;list-style:none}.facts li{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:8px 14px}
.facts b{display:block;font-size:1.15rem}.grid{display:grid;gap:14px;grid-template-columns:repeat(auto-fit,minmax(230px,1fr))}
figure{margin:0}.photo{max-width:460px}figcaption{font-size:.86rem;padding:4px 2px}section.sample{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:14px;margin:14px 0}
section.sample h3{margin:0 0 10px}fieldset{border:0;padding:0;margin:0 0 10px;display:flex;flex-wrap:wrap;gap:8px}legend{float:left;margin-right:8px}
label{cursor:pointer;border:1px solid var(--line);border-radius:16px;padding:2px 14px;background:var(--card)}label:has(:checked){border-color:var(--accent);color:var(--accent)}
label:has(:focus-visible){outline:2px solid var(--accent)}input[type=radio]{position:absolute;opacity:0}
table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:4px 10px;border-bottom:1px solid var(--line)}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}
.warn{border-left:4px solid var(--accent);padding:6px 12px;background:var(--card)}.scroll{overflow-x:auto}
.light{display:none}body:has(#e0:checked) .e0,body:has(#e1:checked) .e1,body:has(#e2:checked) .e2{display:block}
"""


def image(data: bytes, caption: str, kind: str = "") -> str:
    mime = "png" if data[:4] == b"\x89PNG" else "jpeg"
    return (
        f'<figure{kind}><img loading="lazy" alt="{escape(caption)}" src="data:image/{mime};base64,'
        f'{base64.b64encode(data).decode()}"><figcaption>{escape(caption)}</figcaption></figure>'
    )


def warnings(facts: dict) -> list[str]:
    out = [f"{stage}: {w}" for stage, f in facts.items() for w in f.get("warnings", [])]
    lost = facts["poses"].get("unregistered") or []
    if lost:
        out.append(
            f"poses: {len(lost)} of {facts['poses']['photos']} photos could not be placed and are not used: {', '.join(lost[:10])}"
        )
    if facts["capture"].get("clipped_share", 0) > 0.02:
        out.append(
            f'capture: {100 * facts["capture"]["clipped_share"]:.0f} % of the pixels are saturated; there the photos only say "at least this bright"'
        )
    bare = facts["mesh"].get("mask_share_without_surface", 0)
    if bare > 0.03:
        out.append(
            f"mesh: {100 * bare:.0f} % of the automatic masks' pixels show no surface of the object (mostly ground); the final masks leave them out"
        )
    return out


def summary(scene: Scene, facts: dict) -> str:
    total = sum(f.get("seconds", 0) for f in facts.values())
    scores = [
        f["held_out_psnr"]
        for s, f in facts.items()
        if s.startswith("refine") and f.get("held_out_psnr") is not None
    ]
    items = [
        ("preset", scene.preset),
        ("samples", str(scene.samples)),
        ("photos placed", f"{facts['poses']['registered']} of {facts['poses']['photos']}"),
        ("surface", facts["mesh"]["method"]),
        ("sum of stage times", f"{total / 60:.1f} min"),
    ]
    if scores:
        items.insert(3, ("held-out views", f"{sum(scores) / len(scores):.1f} dB PSNR"))
    return (
        "<ul class=facts>"
        + "".join(
            f"<li><span class=soft>{escape(a)}</span><b>{escape(b)}</b></li>" for a, b in items
        )
        + "</ul>"
    )


def sample_section(k: int, s: dict, usd: Path) -> str:
    lights = "".join(
        image(data, f"light, {name}", f' class="light e{i}"')
        for i, (data, name) in enumerate(
            zip(
                s["lights"],
                ("dark exposure: sun and lamps", "middle exposure", "bright exposure: shadows"),
            )
        )
    )
    rest = (
        image(s["render"], f"rendered, {s['psnr']:.1f} dB PSNR in this view")
        + image(s["error"], "error, 0 to 0.25 in sRGB")
        + image(s["relight"], "under another light")
        + image(s["base_color"], "base colour")
        + image(s["roughness"], "roughness, white = 1")
        + image(s["metallic"], "metallic, white = 1")
    )
    return (
        f"<section class=sample><h3>Sample {k} <span class=soft>variant sample_{k} of {escape(usd.name)}</span></h3>"
        f"<div class=grid>{lights}{rest}</div></section>"
    )


def timings(facts: dict) -> str:
    rows = "".join(
        f"<tr><td>{escape(s)}<td class=n>{f.get('seconds', 0):.1f}<td class=n>{f.get('peak_gib', 0):.2f}"
        f"<td class=soft>{escape(str(f.get('why', f.get('up', ''))))}"
        for s, f in facts.items()
    )
    return f"<div class=scroll><table><tr><th>stage<th class=n>seconds<th class=n>peak GiB<th>remark{rows}</table></div>"


def page(
    usd: Path, scene: Scene, facts: dict, pictures: dict, samples: list[dict], view: str, held: bool
) -> str:
    """The whole page as one string."""
    notes = "".join(f"<p class=warn>{escape(w)}</p>" for w in warnings(facts))
    spread = "".join(
        image(data, f"standard deviation of {name}") for name, data in pictures["spread"].items()
    )
    spread = (
        f"<div class=grid>{spread}</div>"
        if spread
        else "<p>One sample shows no spread: ask for more with <code>samples: N</code>.</p>"
    )
    kind = "held out: no fit has seen it" if held else "used in the fit"
    return f"""<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width,initial-scale=1">
<title>{escape(usd.stem)}: Heliograph report</title><style>{STYLE}</style><main>
<h1>{escape(usd.stem)}</h1><p class=soft>Heliograph report. Every sample is one explanation of the same photos: a light and a set of
materials that together reproduce them. Where samples agree, the photos decide; where they differ, the photos leave it open.</p>
{summary(scene, facts)}{notes}
<h2>Samples</h2>
<fieldset><legend class=soft>Exposure of the lights</legend><label><input type=radio name=e id=e0>dark</label>
<label><input type=radio name=e id=e1 checked>middle</label><label><input type=radio name=e id=e2>bright</label></fieldset>
{image(pictures["photo"], f"photo {view} ({kind})", " class=photo")}
{"".join(sample_section(k, s, usd) for k, s in enumerate(samples))}
<h2>What is certain, what is not</h2><p class=soft>Dark: the samples agree. Bright: the photos allow different answers. A common factor between
light and base colour is never visible in photos of matt things; it is fixed by convention (see the asset's customData).
With few samples and a sampler that follows the published method, read the spread as a lower bound.</p>{spread}
<h2>Input and geometry</h2>{image(pictures["photos"], "photos, undistorted, upright")}{image(pictures["masks"], "masks before the surface is known: dimmed = not the object")}
{image(pictures["mesh"], f"surface: {facts['mesh']['method']} ({facts['mesh']['why']})")}
<div class=grid>{image(pictures["atlas"], f"texture atlas, {100 * facts['atlas']['utilisation']:.0f} % used")}</div>
<h2>Time and memory</h2>{timings(facts)}</main></html>
"""
