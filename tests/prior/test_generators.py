"""Generators of lights: what they hold by construction, what training teaches them, their files."""

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.prior import locate
from pipeline.prior.adversarial import AdversarialGenerator
from pipeline.prior.equivariant import EquivariantField
from pipeline.prior.generators import load_generator
from pipeline.prior.locate import WEIGHTS, generator_files
from pipeline.prior.training.adversarial_training import Critic, critic_loss, train
from pipeline.prior.training.auto_decoder import fit
from pipeline.prior.training.data import Data, half
from pipeline.prior.training.lights import Lights, views_of
from pipeline.prior.value_code import Code
from pipeline.prior.weight_files import save_parts
from pipeline.render.envmap import directions, solid_angles
from tests.seeds import numpy_rng, seeded, torch_rng

pytestmark = pytest.mark.usefixtures("one_thread")
NAMES = ("gan_latent", "equivariant_field")
CODE = Code(0.0, 1.0)


def slopes(count: int, rng: np.random.Generator) -> torch.Tensor:
    """Codes (count, 3, 8, 16) that are brighter on one side, in another direction each time, and
    always brighter above than below."""
    d = directions(8, 16)
    angles = rng.uniform(0, 2 * np.pi, count)
    towards = np.stack([np.cos(angles), 0 * angles, np.sin(angles)], -1)
    values = 0.5 * np.einsum("hwi,ni->nhw", d, towards) + 0.4 * d[..., 1]
    return torch.from_numpy(np.repeat(values[:, None], 3, 1).astype(np.float32))


def test_a_field_turns_with_its_latents():
    """By any angle: here by a quarter, and by what is no whole number of columns."""
    torch.manual_seed(seeded(0))
    field = EquivariantField(CODE, count=7, hidden=16, layers=3)
    z = torch.randn(1, *field.latents)
    d = torch.from_numpy(directions(8, 16)).float().reshape(1, -1, 3)
    for angle in (np.pi / 2, 0.3):
        c, s = np.cos(angle), np.sin(angle)
        turn = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]]).float()
        torch.testing.assert_close(field(z @ turn.T, d @ turn.T), field(z, d), atol=1e-5, rtol=0)
    with torch.no_grad():
        assert float((field(z @ turn.T, d) - field(z, d)).abs().max()) > 1e-3


def test_training_teaches_a_field_its_maps():
    """Each map's own latents give it back, where the mean map leaves half of its variance."""
    codes = slopes(12, numpy_rng(0))
    torch.manual_seed(seeded(0))
    field = EquivariantField(CODE, count=4, hidden=32, layers=3)
    latents = fit(field, codes, np.arange(150) / 150)
    with torch.no_grad():
        back = field.codes(latents, 8)
    weight = solid_angles(8, 16)
    error = ((back - codes) ** 2 * weight).sum() / ((codes - codes.mean(0)) ** 2 * weight).sum()
    assert error < 0.1


def test_training_brings_what_a_generator_draws_to_the_lights():
    """Mean by latitude, and how far maps are from it; both are far off before."""
    lights = Lights(slopes(200, numpy_rng(0)), CODE)
    rows = lights.codes.mean((0, 1, 3))
    spread = float((lights.codes - rows[:, None]).std())
    torch.manual_seed(seeded(0))
    generator = AdversarialGenerator(CODE, channels=(16, 16))
    z = torch.randn(100, *generator.latents)

    def apart(made: torch.Tensor) -> tuple[float, float]:
        return float((made.mean((0, 1, 3)) - rows).abs().mean()), float(
            (made - rows[:, None]).std()
        )

    before = apart(generator(z).detach())
    after = apart(train(generator, lights, 150, 0)(z).detach())
    assert before[0] > 0.2 and after[0] < 0.1
    assert abs(after[1] / spread - 1) < 0.35


def test_the_critics_slope_counts_at_true_lights_alone():
    """R1 of a critic that is linear in one pixel: half its squared slope."""
    torch.manual_seed(seeded(0))
    critic = Critic((8, 8))
    true, made = torch.randn(2, 4, 3, 8, 16)
    plain, with_slope = (critic_loss(critic, true.clone(), made, s) for s in (False, True))
    true = true.clone().requires_grad_(True)
    (slope,) = torch.autograd.grad(critic(true).sum(), true)
    r1 = 0.5 * slope.square().sum((1, 2, 3)).mean()
    torch.testing.assert_close(with_slope - plain, 8 * r1, rtol=1e-4, atol=1e-6)


def test_views_are_of_measured_and_made_maps(tmp_path):
    """Red measured maps and blue made ones, none of those held out, which are green; in the code of
    the diffusion priors.
    """
    colors = np.array([[1.0, 0.1, 0.1]] * 4 + [[0.1, 0.1, 1.0]] * 4 + [[0.1, 1.0, 0.1]])
    maps = half(colors[:, None, None] * numpy_rng(0).uniform(0.5, 2, (9, 32, 64, 1)))
    flags = {"made": np.arange(9) // 4 == 1, "held": np.arange(9) == 8}
    np.savez(tmp_path / "data.npz", maps=maps, labels=np.zeros(9, int), **flags)
    data = Data.load(tmp_path / "data.npz", 8)
    lights = views_of(data, 60, 0.7, seeded(0))
    assert lights.codes.shape == (60, 3, 8, 16)
    assert (lights.code.mean, lights.code.std) == (data.mean, data.std)
    brightest = lights.codes.mean((2, 3)).argmax(1)
    assert not (brightest == 1).any()
    assert 0.4 < float((brightest == 0).float().mean()) < 0.95


def test_a_turned_view_is_rolled_and_one_in_two_mirrored():
    """All eight of a view of four columns come, and no other: one of them is missing among 200 with
    a chance of 2e-11.
    """
    view = torch.arange(24.0).reshape(3, 2, 4)
    rolled = [view.roll(k, -1) for k in range(4)]
    possible = {tuple(x.flatten().tolist()) for x in [*rolled, *(x.flip(-1) for x in rolled)]}
    found = Lights(view[None], CODE).turned(200, numpy_rng(0))
    assert {tuple(x.flatten().tolist()) for x in found} == possible and len(possible) == 8


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_committed_generators_draw_lights_that_differ(name):
    """Natural codes have deviation 0.5 by definition; a field's draws are paler. Up is brighter
    than down on average, by .16 or so, many standard errors of so many maps.
    """
    assert sum(file.stat().st_size for file in generator_files(name)) <= 2**21
    generator = load_generator(name)
    noise = torch_rng(0)
    z = torch.randn((32, *generator.latents), generator=noise)
    codes = generator.codes(z, 32)
    assert codes.shape == (32, 3, 32, 64)
    assert 0.15 < float(codes.std()) < 0.7
    assert float(codes.std(0).mean()) > 0.15
    count, rows = {"gan_latent": (512, 32), "equivariant_field": (2048, 8)}[name]
    many = torch.randn((count, *generator.latents), generator=noise)
    with torch.no_grad():
        small = generator.codes(many, rows)
    third = 3 * rows // 8
    assert float(small[:, :, :third].mean()) > float(small[:, :, -third:].mean())
    assert generator.codes(z[:1], 64).shape == (1, 3, 64, 128)


def test_a_network_of_other_rows_is_refused():
    generator = AdversarialGenerator(CODE, channels=(8, 8))
    with pytest.raises(ValueError, match="8 rows do not divide 12"):
        generator.codes(torch.zeros(1, *generator.latents), 12)


def test_generators_are_read_back_and_other_files_named(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(locate, "GENERATORS", tmp_path)
    torch.manual_seed(seeded(0))
    field = EquivariantField(CODE, count=3, hidden=8, layers=2)
    facts = {"format": "equivariant", "mean": 0.0, "std": 1.0, "shape": field.shape}
    save_parts(dict(field.state_dict()), facts, tmp_path / "mine.safetensors")
    z = torch.randn(1, *field.latents)
    torch.testing.assert_close(load_generator("mine").codes(z, 8), field.codes(z, 8))

    with pytest.raises(InputError, match="has no weights"):
        load_generator("yours")
    save_parts(dict(field.state_dict()), facts | {"format": "gaussian"}, tmp_path / "a.safetensors")
    with pytest.raises(InputError, match="not a generator of lights"):
        load_generator("a")
    assert generator_files("split_gibbs") == []
    assert not any(name in {p.stem for p in WEIGHTS.glob("*.safetensors")} for name in NAMES)
