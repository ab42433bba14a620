from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import pytest
import torch
from selection_world import FIXED, demonstrations, fit, predictor

from eaip_prob.errors import HeldOutWarning
from eaip_prob.models import GaussianJointModel, ShrinkageCovariance
from eaip_prob.phase import DTWClock, ElapsedClock, KnownPhase, MarginalClock
from eaip_prob.selection import NOISE_MULTIPLES, _Search, _simplest_search


def test_amount_without_groups_and_a_given_one() -> None:
    for model, groups, amount in ((GaussianJointModel(), 1, 0.1), (GaussianJointModel(FIXED), 2, 0.05)):
        with nullcontext() if groups > 1 else pytest.warns(HeldOutWarning):
            fitted = fit(demonstrations(8, groups=groups), model=model)
        assert isinstance(fitted.model, GaussianJointModel)
        assert fitted.model.covariance == ShrinkageCovariance(amount)


def test_clock_comes_first_with_the_middle_amount(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, float | None]] = []

    def noted(score: Callable[[_Search], Any]) -> Callable[[_Search], Any]:
        def asking(search: _Search) -> Any:
            assert isinstance(search.model, GaussianJointModel)
            assert isinstance(search.model.covariance, ShrinkageCovariance)
            asked.append((type(search.held_out()[0].fitted.phase).__name__, search.model.covariance.amount))
            return score(search)

        return asking

    for name in ("density", "group_densities"):
        monkeypatch.setattr(_Search, name, noted(getattr(_Search, name)))
    clocks = (ElapsedClock(), MarginalClock(num_durations=5))
    fit(demonstrations(24, sensor=0.05, tempo=0.25), phase=clocks, model=GaussianJointModel(), noise=0.05)
    clock = asked[2][0]
    assert asked[:2] == [("ElapsedClock", 0.1), ("MarginalClock", 0.1)]
    assert asked[2:] == [(clock, amount) for amount in (0.001, 0.01, 0.1, 0.3, 0.6)]


@dataclass(frozen=True, eq=False)
class Scored:
    """A search whose density in each group is given."""

    name: str
    densities: list[float]
    folds: tuple[int, ...] = (0,)

    def group_densities(self) -> torch.Tensor:
        return torch.tensor(self.densities, dtype=torch.float64)


def test_a_richer_clock_must_be_better_by_a_standard_error() -> None:
    simple = Scored("simple", [1.0, 2.0, 3.0, 4.0])
    # Ahead by 0.2 in the mean, by -0.3 to 0.7 in the groups: standard error 0.208.
    unsure = Scored("unsure", [1.7, 2.2, 3.2, 3.7])
    sure = Scored("sure", [1.3, 2.2, 3.2, 4.2])  # by 0.225, standard error 0.025
    for searches, expected in (
        ([simple, unsure], "simple"),
        ([simple, sure], "sure"),
        ([simple, unsure, sure], "unsure"),
        ([sure, simple], "sure"),
        ([simple, Scored("same", simple.densities)], "simple"),
        ([Scored("one group", [1.0]), Scored("better", [1.5])], "better"),
        ([Scored("nothing left out", [], ()), sure], "nothing left out"),
    ):
        assert _simplest_search(searches).name == expected  # pyright: ignore[reportArgumentType]


class Peaks:
    """A fold whose score at each multiple of sigma is given."""

    def __init__(self, scores: dict[float, float], scale: float, multiple: float = 0.0) -> None:
        self.scores, self.scale, self.multiple, self.asked = scores, scale, multiple, list[float]()

    def given(self, noise: torch.Tensor) -> Peaks:
        multiple = min(NOISE_MULTIPLES, key=lambda m: abs(m - float(noise) / self.scale))
        self.asked.append(multiple)
        return Peaks(self.scores, self.scale, multiple)

    def density(self, scene_only: bool) -> torch.Tensor:
        assert not scene_only
        return torch.tensor(self.scores[self.multiple], dtype=torch.float64)


def climbed(*scores: float) -> tuple[float, list[float]]:
    fold = Peaks(dict(zip(NOISE_MULTIPLES, scores, strict=True)), 40.0)
    scale, none = torch.tensor([40.0], dtype=torch.float64), torch.zeros(0, dtype=torch.float64)
    search = _Search(predictor(), None, GaussianJointModel(), [], scale, none)  # pyright: ignore[reportArgumentType]
    return search._climbed([fold]), fold.asked  # pyright: ignore[reportArgumentType]


def test_climb_finds_a_peak_at_either_end() -> None:
    assert climbed(9, 8, 7, 6, 5, 4, 3, 2, 1, 0)[0] == 0.002
    assert climbed(0, 1, 2, 3, 4, 5, 6, 7, 8, 9)[0] == 10.0
    assert climbed(0, 1, 2, 3, 4, 9, 6, 5, 4, 3)[0] == 0.1
    assert climbed(0, 1, 2, 9, 4, 3, 2, 1, 1, 1)[0] == 0.02


def test_climb_takes_not_listening_where_it_is_better_still() -> None:
    assert climbed(0, 1, 2, 5, 4, 3, 2, 3, 6, 8)[0] == 10.0
    assert climbed(0, 1, 2, 5, 4, 3, 2, 3, 4, 4.9)[0] == 0.02
    assert climbed(0, 1, 2, 5, 4, 3, 2, 3, 9, 4)[0] == 0.02


def test_climb_asks_for_each_score_once_and_stops_at_a_plateau() -> None:
    chosen, asked = climbed(0, 7, 7, 7, 7, 1, 1, 1, 1, 1)
    assert chosen == 0.02 and sorted(asked) == [0.01, 0.02, 0.05, 10.0]
    chosen, asked = climbed(0, 1, 2, 3, 4, 5, 6, 5, 4, 3)
    assert chosen == 0.3 and len(asked) == len(set(asked)) and set(asked) == {0.01, 0.02, 0.05, 0.1, 0.3, 1.0, 10.0}


def test_clock_is_chosen_by_the_future_of_the_target() -> None:
    clocks = (ElapsedClock(), MarginalClock(num_durations=7))
    given = {"phase": clocks, "noise": 0.05, "environment_noise": 5.0}
    steady = demonstrations(24, sensor=0.05, tempo=0.25)
    assert isinstance(fit(steady, **given).phase, MarginalClock)
    with pytest.warns(HeldOutWarning):
        assert isinstance(fit(demonstrations(24, sensor=0.05, groups=1), **given).phase, ElapsedClock)
    assert isinstance(fit(demonstrations(24, sensor=0.05), **given).phase, ElapsedClock)
    assert isinstance(fit(demonstrations(24, sensor=0.05), **given | {"phase": clocks[::-1]}).phase, MarginalClock)


def test_only_clock_is_kept() -> None:
    for clock in (MarginalClock(num_durations=5), DTWClock(num_samples=20), KnownPhase()):
        assert isinstance(
            fit(demonstrations(6, tempo=0.1), phase=clock, noise=0.3, environment_noise=5.0).phase, type(clock)
        )
