"""Camera rays in single precision and one loop, against a view's own."""

import numpy as np

from pipeline.geometry.cameras import View
from pipeline.render.camera_rays import rays_into
from tests.conftest import look_at
from tests.seeds import numpy_rng


def test_rays_are_the_views_own():
    rng = numpy_rng(0)
    poses = [look_at([3.0, 1.0, 0.5]), look_at([-1.0, 2.0, -2.0])]
    views = [
        View(f"v{k}", "", 640, 480, 700 + k, 690, 320, 230 - k, p) for k, p in enumerate(poses)
    ]
    view = rng.integers(2, size=500)
    pixel, offset = rng.integers(480, size=(500, 2)), rng.random((500, 2))

    single = lambda values: np.array(values, np.float32)
    origin = single([v.position for v in views])
    turn = single([v.world_to_camera[:3, :3] for v in views])
    lens = single([[v.fx, v.fy, v.cx, v.cy] for v in views])
    found = np.empty((2, 500, 3), np.float32)
    rays_into(view, pixel, offset, origin, turn, lens, found)

    for k, of_view in enumerate(views):
        mine = view == k
        expected = of_view.rays((pixel + offset)[mine])
        assert np.allclose(found[:, mine], np.broadcast_arrays(*expected), atol=1e-5)
