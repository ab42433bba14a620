"""Which share of a predicted deviation is right, from groups left out.

The slope of the regression, through the origin, of true on predicted deviations::

    g = <predicted deviation, true deviation> / <predicted deviation, predicted deviation>,   0 <= g <= 1

It is 1 for evidence used as it deserves, 0 for evidence that tells nothing of new people, and needs no search.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64
from eaip_prob.errors import ShapeError

_LEAST_EXPLAINED = 0.005


@dataclass(frozen=True)
class Slope:
    """Slope of true on predicted deviations over left-out groups.

    Args:
        value: the share that is believed, in [0, 1]; 0 where it explains less than 0.5 % of the squared deviation, or
            where the slope is below one standard error.
        estimate: the slope of the regression before that.
        error: its standard error over groups (jackknife); infinite with one group.
        explained: share of the squared deviation that believing `value` of the movement removes.
    """

    value: float = 1.0
    estimate: float = 1.0
    error: float = 0.0
    explained: float = 1.0

    @classmethod
    def of(
        cls,
        product: Float[Tensor, "groups"],
        power: Float[Tensor, "groups"],
        total: Float[Tensor, "groups"],
        towards: float | None = None,
    ) -> Slope:
        """The slope from sums of each group.

        With `towards`, the slope s goes only so far from that value r as its gain is certain over groups: the gain G of
        believing s rather than r (less squared deviation left), known to a variance v, moves r by G^2 / (G^2 + v) of
        the way. v is the squared standard error times the variance of a t variable with one degree of freedom less
        than groups: a gain of twice its error goes 79 % of the way with a hundred people, and 57 % with four.

        Args:
            product: sum of predicted times true deviation.
            power: sum of squared predicted deviations.
            total: sum of squared true deviations.
            towards: the value, 0 or 1, that an uncertain slope stays near to; None takes the slope as it is.

        Raises:
            ShapeError: other than one number of each kind for every group.

        Example:
            >>> import torch
            >>> Slope.of(torch.tensor([2.0, 2.0]), torch.tensor([4.0, 4.0]), torch.tensor([2.0, 2.0])).value
            0.5
        """
        sums = [as_float64("sums", part) for part in (product, power, total)]
        if len({part.shape for part in sums}) > 1 or sums[0].ndim != 1 or len(sums[0]) == 0:
            raise ShapeError(f"Expected three sums with shape (groups,), got {[tuple(part.shape) for part in sums]}.")
        product, power, total = sums
        if float(power.sum()) <= 0 or float(total.sum()) <= 0:
            return cls(0.0, 0.0, math.inf, 0.0)
        estimate = float(product.sum() / power.sum())
        error = _jackknife(product, power)
        share = min(max(estimate, 0.0), 1.0)
        if towards is not None:
            share = towards + (share - towards) * _certainty(
                _left(towards, product, power) - _left(share, product, power)
            )
        explained = float(-_left(share, product, power).sum() / total.sum())
        if explained < _LEAST_EXPLAINED or estimate < error:
            return cls(0.0, estimate, error, 0.0)
        return cls(share, estimate, error, explained)


def _jackknife(product: Tensor, power: Tensor) -> float:
    """Standard error of a ratio of sums, from the ratios without each group in turn."""
    count = len(product)
    rest = power.sum() - power
    if count < 2 or float(rest.min()) <= 0:
        return math.inf
    without = (product.sum() - product) / rest
    return float(((count - 1) / count * (without - without.mean()).square().sum()).sqrt())


def _left(share: float, product: Tensor, power: Tensor) -> Float[Tensor, "groups"]:
    """Squared deviation that is left of each group where a share is believed, less that where nothing is."""
    return share**2 * power - 2.0 * share * product


def _certainty(gain: Float[Tensor, "groups"]) -> float:
    """G^2 / (G^2 + v) of a mean gain G."""
    mean, count = float(gain.mean()), len(gain)
    if mean <= 0.0 or count < 2:
        return 0.0
    return 1.0 / (1.0 + _t_variance(count) * float((gain / mean).var()) / count)


def _t_variance(num_groups: int) -> float:
    """Variance of a t variable; with fewer than four groups, where it is infinite, what goes on from four."""
    freedom = num_groups - 1
    return freedom / (freedom - 2) if freedom > 2 else 9.0 / max(freedom, 1)
