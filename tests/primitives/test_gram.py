from __future__ import annotations

import pytest
import torch

from eaip_prob.primitives import DMP, AbstractPrimitive, Boundary, ProMP

PRIMITIVES = {
    "promp": ProMP(num_basis=6, limit=1.4),
    "learned": DMP(num_basis=5, limit=1.4),
    "given": DMP(num_basis=5, limit=1.4, boundary="given"),
}


def draw(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("name", list(PRIMITIVES))
@pytest.mark.parametrize(("num_signals", "duration", "num_phases"), [(1, 1.0, 200), (3, 2.7, 17)])
def test_weights_give_the_mean_square_of_the_motion(
    name: str, num_signals: int, duration: float, num_phases: int
) -> None:
    primitive: AbstractPrimitive = PRIMITIVES[name]
    gram = primitive.gram(num_signals, duration, num_phases)
    assert gram.shape == (num_signals * primitive.num_weights,) * 2
    rest = Boundary(torch.zeros(num_signals), torch.zeros(num_signals)) if primitive.needs_boundary else None
    for weights in draw(0, 3, num_signals * primitive.num_weights):
        total = 0.0
        for number in range(num_phases):
            phase = torch.tensor([1.4 * number / (num_phases - 1)], dtype=torch.float64)
            total += float(primitive.decode(weights, phase, duration, rest).square().sum()) / num_phases
        assert float(weights @ gram @ weights) == pytest.approx(total, rel=1e-9)


@pytest.mark.parametrize("name", list(PRIMITIVES))
def test_signals_have_no_part_in_each_other(name: str) -> None:
    primitive = PRIMITIVES[name]
    size, gram = primitive.num_weights, primitive.gram(2)
    assert bool((gram[:size, size:] == 0).all())
    assert torch.equal(gram[:size, :size], primitive.gram(1)) and torch.equal(gram[size:, size:], primitive.gram(1))


def test_only_promp_weights_are_positions() -> None:
    assert {name: one.weights_are_positions for name, one in PRIMITIVES.items()} == {
        "promp": True,
        "learned": False,
        "given": False,
    }
