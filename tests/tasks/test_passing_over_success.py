from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.tasks.passing_over import clearance, passed, rise

WIDTH, HEIGHT, BOUND = 120.0, 80.0, 50.0


def _path(*points: tuple[float, float]) -> torch.Tensor:
    return torch.tensor(points, dtype=torch.float64)


OVER = _path((-150, 10), (-70, 95), (70, 95), (150, 10))
PATHS = {
    "over": (OVER, True),
    "two samples": (_path((-400, 81), (400, 82)), True),
    "cuts a corner between samples": (_path((-150, 10), (-61, 60), (-40, 95), (70, 95), (150, 10)), False),
    "through, no sample inside": (_path((-150, 10), (150, 10)), False),
    "through both sides, steep": (_path((-150, -900), (80, 20)), False),
    "touches the top": (_path((-150, 80), (150, 80)), False),
    "stops early": (OVER[:2], False),
    "ends over the rectangle": (_path((-150, 10), (-70, 95), (0, 95)), False),
    "ends at the right side": (_path((-150, 10), (-70, 95), (60, 95)), False),
    "stays left": (_path((-150, 10), (-100, 95), (-150, 120)), False),
    "starts over the rectangle": (_path((0, 95), (70, 95), (150, 10)), False),
    "passes under": (_path((-150, 10), (-100, -30), (100, -30), (150, 10)), False),
    "comes back": (torch.cat([OVER, OVER.flip(0)]), False),
    "from right to left": (OVER.flip(0), False),
    "too high": (_path((-150, 10), (-70, 95), (0, 131), (70, 95), (150, 10)), False),
    "just under the bound": (_path((-150, 10), (-70, 95), (0, 129), (70, 95), (150, 10)), True),
}


@pytest.mark.parametrize("name", PATHS)
def test_hand_made_paths(name: str) -> None:
    path, expected = PATHS[name]
    assert bool(passed(path, WIDTH, HEIGHT, BOUND)) is expected


def _by_sampling(path: np.ndarray, width: float, height: float) -> float:
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    points = np.concatenate([a + share * (b - a) for a, b in zip(path[:-1], path[1:], strict=True)])
    dx = np.maximum(np.abs(points[:, 0]) - width / 2, 0.0)
    dy = np.maximum(points[:, 1] - height, 0.0)
    return float(np.sqrt(dx**2 + dy**2).min())


def test_clearance_agrees_with_dense_sampling() -> None:
    rng = np.random.default_rng(4)
    paths = rng.uniform([-200.0, -20.0], [200.0, 250.0], (60, 3, 2))
    paths[:20, :, 1] += 90.0
    widths, heights = rng.uniform(20.0, 200.0, 60), rng.uniform(20.0, 150.0, 60)
    exact = clearance(torch.tensor(paths), torch.tensor(widths), torch.tensor(heights)).numpy()
    sampled = np.array([_by_sampling(*each) for each in zip(paths, widths, heights, strict=True)])
    # Samples are at most 0.12 px apart; the distance changes by no more than the way.
    assert (exact <= sampled + 1e-9).all() and (sampled - exact < 0.07).all()
    assert 15 < (exact > 0).sum() < 55


def test_clearance_to_a_corner_between_samples() -> None:
    # A line at 45 degrees that passes so far above a corner has a distance of that over the root of two.
    for above in (28.0, 1e-3):
        line = _path((-160.0, HEIGHT - 100.0 + above), (40.0, HEIGHT + 100.0 + above))
        for path in (line, line.flip(0), line * torch.tensor([-1.0, 1.0])):
            assert float(clearance(path, WIDTH, HEIGHT)) == pytest.approx(above / 2**0.5)


def test_batches_agree_with_single_paths() -> None:
    generator = torch.Generator().manual_seed(2)
    paths = OVER + 12.0 * torch.randn(2, 3, 4, 2, generator=generator, dtype=torch.float64)
    width = 110.0 + 20.0 * torch.rand(2, 3, generator=generator, dtype=torch.float64)
    height = 70.0 + 20.0 * torch.rand(3, generator=generator, dtype=torch.float64)
    together = passed(paths, width, height, BOUND), clearance(paths, width, height), rise(paths, height)
    for i, j in np.ndindex(2, 3):
        path, w, h = paths[i, j], float(width[i, j]), float(height[j])
        assert bool(together[0][i, j]) == bool(passed(path, w, h, BOUND))
        torch.testing.assert_close(together[1][i, j], clearance(path, w, h))
        torch.testing.assert_close(together[2][i, j], rise(path, h))
    assert 0 < int(together[0].sum()) < 6


def test_one_path_against_many_rectangles() -> None:
    height = torch.tensor([[30.0], [80.0], [96.0]], dtype=torch.float64)
    width = torch.tensor([120.0, 320.0], dtype=torch.float64)
    assert passed(OVER, width, height, BOUND).tolist() == [[False, False], [True, False], [False, False]]


def test_padding_is_not_read() -> None:
    padded = torch.cat([torch.full((1, 2), torch.nan), OVER, torch.tensor([[0.0, 0.0], [0.0, 999.0]])]).double()
    seen = torch.tensor([False, True, True, True, True, False, False])
    assert bool(passed(padded, WIDTH, HEIGHT, BOUND, seen))
    assert not bool(passed(padded[1:], WIDTH, HEIGHT, BOUND))
    torch.testing.assert_close(clearance(padded, WIDTH, HEIGHT, seen), clearance(OVER, WIDTH, HEIGHT))
    torch.testing.assert_close(rise(padded, HEIGHT, seen), rise(OVER, HEIGHT))


def test_standing_still_and_single_samples() -> None:
    still = _path((-150, 10), (-150, 10), (-70, 95), (70, 95), (150, 10), (150, 10))
    torch.testing.assert_close(clearance(still, WIDTH, HEIGHT), clearance(OVER, WIDTH, HEIGHT))
    assert float(clearance(_path((-63, 84)), WIDTH, HEIGHT)) == pytest.approx(5.0)
    assert not bool(passed(_path((-63, 84)), WIDTH, HEIGHT, BOUND))


def test_bad_input_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"Expected values with shape \(\*batch, T, 2\), got \(4, 1\)"):
        passed(OVER[:, :1], WIDTH, HEIGHT, BOUND)
    with pytest.raises(InputError, match="Expected width above zero, in px, got -3"):
        clearance(OVER, torch.tensor([5.0, -3.0]), HEIGHT)
    with pytest.raises(InputError, match="Expected height above zero, in px, got 0"):
        clearance(OVER, WIDTH, 0.0)
    with pytest.raises(InputError, match="Expected bound above zero"):
        passed(OVER, WIDTH, HEIGHT, 0.0)
    with pytest.raises(InputError, match="finite numbers in values"):
        passed(OVER * torch.nan, WIDTH, HEIGHT, BOUND)
    with pytest.raises(InputError, match="at least one sample in every path"):
        passed(OVER, WIDTH, HEIGHT, BOUND, torch.zeros(4, dtype=torch.bool))
    with pytest.raises(ShapeError, match=r"Expected seen with shape \(4,\), got \(3,\)"):
        passed(OVER, WIDTH, HEIGHT, BOUND, torch.ones(3, dtype=torch.bool))
