"""The report's viewer draws what the split sum says, in a real browser: `pytest -m heavy`, seconds.

Needs Chromium or Chrome on the path; without one the tests are skipped and say so.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pipeline.report
from pipeline.base.images import linear_to_srgb
from pipeline.geometry.mesh_io import load_mesh
from pipeline.posterior.illumination.split_sum import ROUGHNESS, facet_albedo
from pipeline.render.envmap import directions
from pipeline.render.renderer import Explanation
from pipeline.report.viewer import ROWS, viewer_data

pytestmark = pytest.mark.heavy
SCRIPT = (Path(pipeline.report.__file__).parent / "viewer.js").read_text(encoding="utf-8")
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SIDE = 400  # pixels of the drawing
LIMIT = 120  # seconds, many times what a picture takes
COLOR = (0.6, 0.3, 0.1)


def drawing(data: dict, folder: Path) -> np.ndarray:
    """What a browser shows (SIDE, SIDE, 3), uint8, of a page that holds nothing but the viewer."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"no browser on the path: none of {', '.join(BROWSERS)}")
    page, picture = folder / "page.html", folder / "page.png"
    page.write_text(
        f"""<body style="margin:0;background:#fff">
<canvas id="viewer" style="width:{SIDE}px;height:{SIDE}px;display:block"></canvas>
<p id="viewer-none" hidden></p><div id="viewer-box"></div>
<script type="application/json" id="viewer-data">{json.dumps(data)}</script>
<script>{SCRIPT}</script>"""
    )
    command = [browser, "--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
    command += ["--enable-unsafe-swiftshader", "--virtual-time-budget=20000"]
    command += [f"--window-size={SIDE},{SIDE}", f"--user-data-dir={folder / 'profile'}"]
    command += ["--hide-scrollbars", f"--screenshot={picture}", page.as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=LIMIT)
    return np.asarray(Image.open(picture).convert("RGB"))[:SIDE, :SIDE]


def ball_under(light: np.ndarray, ball: Path, roughness: float, metallic: float, ior: float = 1.5):
    """Data of a ball of one material, seen from +z."""
    full = lambda v: np.full((16, 16), v, np.float32)
    color = np.broadcast_to(np.float32(COLOR), (16, 16, 3))
    x = Explanation(light.astype(np.float32), color, full(roughness), full(metallic), ior=ior)
    toward = np.array([0.0, 0.0, 1.0])
    data = viewer_data(load_mesh(ball / "mesh_uv.ply"), [("sample 0", x)], toward, 1.0)
    assert data is not None
    return data


@pytest.mark.parametrize(("roughness", "metallic"), [(0.5, 0.0), (1.0, 0.0), (0.3, 1.0)])
def test_the_middle_of_a_ball_under_even_light_has_the_split_sum_s_radiance(
    ball, tmp_path, roughness, metallic
):
    """a (1 - m) + F0 A + B there, A and B being the table's head-on; within two levels of 255."""
    shown = drawing(
        ball_under(np.full((ROWS, 2 * ROWS, 3), 0.9), ball, roughness, metallic), tmp_path
    )
    A, B = (np.interp(roughness, ROUGHNESS, part[:, -1]) for part in facet_albedo().numpy())
    color = np.array(COLOR)
    f0 = 0.04 * (1 - metallic) + color * metallic
    expected = 255 * linear_to_srgb(0.9 * (color * (1 - metallic) + f0 * A + B))
    middle = SIDE // 2
    found = shown[middle - 5 : middle + 5, middle - 5 : middle + 5].reshape(-1, 3).mean(0)
    assert np.abs(found - expected).max() < 2, (found, expected)
    assert (shown[:5, :5] == 255).all()  # the page beside the ball


@pytest.mark.parametrize(
    ("axis", "brighter"), [(0, np.s_[:, SIDE // 2 :]), (1, np.s_[: SIDE // 2, :])]
)
def test_light_from_a_side_is_on_that_side_of_the_picture(ball, tmp_path, axis, brighter):
    """Seen from +z with y up: light from +x is on the right, light from +y on top. (sRGB values of
    the two halves are as 1.45 to 1.)
    """
    side = directions(ROWS, 2 * ROWS)[..., axis]
    light = np.repeat((side > 0)[..., None], 3, -1).astype(np.float32)
    shown = drawing(ball_under(light, ball, 1.0, 0.0), tmp_path).astype(float)
    on_ball = (shown < 250).any(-1)
    lit = np.where(on_ball, shown.sum(-1), 0)
    assert lit[brighter].sum() > 1.25 * (lit.sum() - lit[brighter].sum())
