"""The model under test and what it is fitted to; each fit is made once and shared by all checks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from jaxtyping import Float
from torch import Tensor

from eaip_prob.gaussian import BlockGaussian
from eaip_prob.models import AbstractJointModel, Posterior
from eaip_prob.testing.world import World

NUM_SOME, NUM_FEW, NUM_MANY = 40, 7, 600
NUM_GROUPS = 5
CLOSE = 1e-6


@dataclass(frozen=True, eq=False)
class Subject:
    """What the checks of one model share.

    Args:
        make: gives a new model, not yet fitted.
        world: the truth.
    """

    make: Callable[[], AbstractJointModel]
    world: World = field(default_factory=World.default)

    @cached_property
    def name(self) -> str:
        """Class of the model."""
        return type(self.make()).__name__

    def weights(self, num: int) -> dict[str, Tensor]:
        """{block: (N, K)} of the first demonstrations."""
        return self.world.blocks(self.world.rows(num, seed=100 + num))

    @staticmethod
    def groups(num: int) -> list[str]:
        """Labels of the demonstrations, members of a group apart from one another."""
        return [f"person {index % NUM_GROUPS}" for index in range(num)]

    def fit(self, num: int) -> AbstractJointModel:
        """A new model fitted to so many demonstrations."""
        return self.make().fit(self.weights(num), groups=self.groups(num))

    @cached_property
    def fitted(self) -> AbstractJointModel:
        """Fitted to 40 demonstrations of 10 weights."""
        return self.fit(NUM_SOME)

    @cached_property
    def fitted_to_few(self) -> AbstractJointModel:
        """Fitted to fewer demonstrations than weights."""
        return self.fit(NUM_FEW)

    @cached_property
    def fitted_to_many(self) -> AbstractJointModel:
        """Fitted to so many that the truth can be learnt."""
        return self.fit(NUM_MANY)

    def require_same(
        self, came: Posterior | BlockGaussian, expected: Posterior | BlockGaussian, what: str, advice: str
    ) -> None:
        """Compares two beliefs, in standard deviations of the weights.

        Raises:
            AssertionError: they differ.
        """
        one, other = (part.moment_matched() if isinstance(part, Posterior) else part for part in (came, expected))
        if tuple(one.layout.names) != tuple(other.layout.names):
            raise AssertionError(f"{what} with the blocks {one.layout.names}, not {other.layout.names}; {advice}")
        scale = self.scale_of(one)
        require_close(one.mean / scale, other.mean / scale, f"{what} with another mean", advice)
        scale = scale[:, None] * scale
        require_close(one.covariance / scale, other.covariance / scale, f"{what} with another covariance", advice)
        if isinstance(came, Posterior) and isinstance(expected, Posterior):
            evidence = came.log_evidence, expected.log_evidence
            require_close(*evidence, f"{what} with another log evidence", advice)

    def scale_of(self, belief: BlockGaussian) -> Float[Tensor, "weights"]:
        """Standard deviations of the belief's weights in the world."""
        layout = self.world.truth.layout
        return self.world.scale[layout.indices([name for name in belief.layout.names])]


def require_close(came: Tensor, expected: Tensor, what: str, advice: str, tolerance: float = CLOSE) -> None:
    """Raises an AssertionError where two tensors differ by more than the tolerance, relative to 1 or their size."""
    if came.shape != expected.shape:
        raise AssertionError(f"{what}, of shape {tuple(came.shape)} instead of {tuple(expected.shape)}; {advice}")
    off = (came - expected).abs() / expected.abs().clamp_min(1.0)
    if not bool((off <= tolerance).all()):  # NaN included
        raise AssertionError(f"{what}, by {float(off.max()):.2g} where {tolerance:.0e} is round-off; {advice}")


def refused(call: Callable[[], object], *kinds: type[Exception]) -> str | None:
    """None where the call raises one of these errors with a message, else what came instead."""
    try:
        call()
    except kinds as error:
        return None if str(error) else f"{type(error).__name__} without a message"
    except Exception as error:
        return f"{type(error).__name__} ({' '.join(str(error).split())[:80]})"
    return "an answer"
