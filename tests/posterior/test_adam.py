"""Adam by torch's function: the bits of torch's class, without its compiler."""

import subprocess
import sys

import pytest
import torch

from pipeline.posterior.adam import Adam
from tests.seeds import torch_rng

BETAS = (0.9, 0.99)


def test_same_bits_as_torchs_class():
    """With rates of their own and common ones, and a value that has no slope for a while."""
    noise = torch_rng(0)
    first = [torch.randn(7, generator=noise), torch.randn((3, 4), generator=noise)]
    ours, theirs = ([value.clone() for value in first] for _ in range(2))
    mine = Adam(ours, [0.1, 0.02], BETAS)
    groups = [{"params": [v], "lr": rate} for v, rate in zip(theirs, [0.1, 0.02])]
    reference = torch.optim.Adam(groups, betas=BETAS)
    for step in range(30):
        slopes = [torch.randn(v.shape, generator=noise) * 10.0 ** (step % 5 - 2) for v in first]
        if step < 3:
            slopes[1] = None
        if step == 20:
            mine.set_learning_rate(0.007)
            for group in reference.param_groups:
                group["lr"] = 0.007
        for values in (ours, theirs):
            for value, slope in zip(values, slopes):
                value.grad = slope
        mine.step()
        reference.step()
    for a, b in zip(ours, theirs):
        assert torch.equal(a, b)


@pytest.mark.slow
def test_the_compiler_is_not_imported():
    code = (
        "import sys, torch; from pipeline.posterior.adam import Adam\n"
        "x = torch.zeros(3); x.grad = torch.ones(3); a = Adam([x], [0.1], (0.9, 0.99)); a.step()\n"
        "assert x[0] < 0; sys.exit('torch._dynamo' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
