"""Does the beginning of a motion say what the environment is? Ridge regression, judged on groups left out.

If it does, watching can replace the environment; if it does not, the environment adds what watching cannot give.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite, check_shape
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.evaluation.groups import group_index
from eaip_prob.linalg import psd_solve

RIDGES = tuple(10.0**power for power in range(-6, 3))


def explained(
    features: Float[Tensor, "motions features"],
    beginnings: Float[Tensor, "motions inputs"],
    groups: Sequence[int | str] | Tensor,
    ridges: Sequence[float] = RIDGES,
) -> Float[Tensor, "features"]:
    """R^2 of each feature as predicted from the beginnings of motions of groups left out.

    Each group in turn is predicted by a ridge regression fitted to the others: inputs centred and scaled to unit
    variance there, so that units do not matter, and the squared weights times `ridge * F` added to the mean squared
    error (F, the number of inputs, is their total variance). The ridge is chosen for each feature by leaving out one
    further group. R^2 = 1 - SSE / SST over all left-out predictions, SST about the mean of all motions. It is
    negative where that mean predicts better, as it will for a feature that the beginning says nothing about.

    Args:
        features: (N, E), any units.
        beginnings: (N, F), e.g. the flattened first samples of each motion, any units.
        groups: (N,), what is left out together (the object, the person); at least 3 different ones.
        ridges: amounts to choose from, above zero.

    Returns:
        (E,), at most 1.

    Raises:
        ShapeError: other numbers of motions, or axes missing.
        InputError: NaN, fewer than 3 groups, a feature that never varies, or a ridge of zero or below.

    Example:
        >>> start = torch.arange(12.0, dtype=torch.float64)[:, None]
        >>> r2 = explained(5.0 - 2.0 * start, start, [i // 3 for i in range(12)])
        >>> bool(r2 > 0.99)
        True
    """
    targets, inputs, amounts = _checked(features, beginnings, ridges)
    predicted = left_out_predictions(targets, inputs, amounts, groups)
    total = (targets - targets.mean(0)).square().sum(0)
    return 1.0 - (targets - predicted).square().sum(0) / total


def identified(
    labels: Sequence[str],
    beginnings: Float[Tensor, "motions inputs"],
    groups: Sequence[int | str] | Tensor,
    ridges: Sequence[float] = RIDGES,
) -> float:
    """Share of motions whose label is found from their beginnings, groups left out.

    One indicator for each label is predicted as features are in `explained`; the largest one is the answer.

    Args:
        labels: N, two or more different ones.
        beginnings: (N, F), as of `explained`.
        groups: (N,), as of `explained`.
        ridges: as of `explained`.

    Returns:
        0 to 1; guessing the most frequent of C labels that are equally frequent gives 1 / C.

    Raises:
        ShapeError: other numbers of motions, or axes missing.
        InputError: one label, fewer than 3 groups, NaN, or a ridge of zero or below.

    Example:
        >>> start = torch.arange(12.0, dtype=torch.float64)[:, None] % 4
        >>> identified(["small" if s < 2 else "large" for s in start[:, 0]], start, [i // 4 for i in range(12)])
        1.0
    """
    names = sorted(set(labels))
    if len(names) < 2:
        raise InputError(f"Expected two or more different labels, got {names}.")
    answer = torch.tensor([names.index(label) for label in labels])
    indicators = torch.nn.functional.one_hot(answer, len(names)).double()
    predicted = left_out_predictions(*_checked(indicators, beginnings, ridges), groups)
    return float((predicted.argmax(-1) == answer).double().mean())


def left_out_predictions(
    targets: Float[Tensor, "motions features"],
    inputs: Float[Tensor, "motions inputs"],
    amounts: Float[Tensor, "ridges"],
    groups: Sequence[int | str] | Tensor,
) -> Float[Tensor, "motions features"]:
    """Each motion's features as predicted by the motions of other groups (see `explained`)."""
    index, num_groups = group_index(groups, len(targets))
    if num_groups < 3:
        raise InputError(f"Expected at least 3 groups, to leave one out twice, got {num_groups}. Use finer groups.")
    predicted = torch.empty_like(targets)
    for group in range(num_groups):
        rest, held = index != group, index == group
        chosen = _left_out_errors(inputs[rest], targets[rest], index[rest], amounts).argmin(0)
        candidates = _ridge_predictions(inputs[rest], targets[rest], inputs[held], amounts)
        predicted[held] = candidates.gather(0, chosen.expand(1, len(candidates[0]), -1))[0]
    return predicted


def _checked(features: Tensor, beginnings: Tensor, ridges: Sequence[float]) -> tuple[Tensor, Tensor, Tensor]:
    targets, inputs = as_float64("features", features), as_float64("beginnings", beginnings)
    amounts = as_float64("ridges", ridges)
    if targets.ndim != 2:
        raise ShapeError(f"Expected features with shape (N, E), got {tuple(targets.shape)}.")
    if inputs.ndim != 2 or len(inputs) != len(targets) or inputs.shape[1] == 0:
        raise ShapeError(f"Expected beginnings with shape ({len(targets)}, F), got {tuple(inputs.shape)}.")
    check_shape("ridges", amounts, ["amounts"])
    check_finite("features", targets)
    check_finite("beginnings", inputs)
    if amounts.numel() == 0 or not bool((amounts > 0).all()):
        raise InputError(f"Expected ridges above zero, at least one, got {tuple(ridges)}.")
    still = (targets == targets[:1]).all(0)
    if bool(still.any()):
        raise InputError(f"Expected features that vary, feature {int(still.nonzero()[0])} is constant. Leave it out.")
    return targets, inputs, amounts


def _left_out_errors(inputs: Tensor, targets: Tensor, index: Tensor, amounts: Tensor) -> Tensor:
    """Squared errors, (ridges, features), summed over predictions of each group by the others."""
    errors = targets.new_zeros(len(amounts), targets.shape[1])
    for group in index.unique():
        rest, held = index != group, index == group
        predicted = _ridge_predictions(inputs[rest], targets[rest], inputs[held], amounts)
        errors = errors + (predicted - targets[held]).square().sum(1)
    return errors


def _ridge_predictions(inputs: Tensor, targets: Tensor, queries: Tensor, amounts: Tensor) -> Tensor:
    """Predictions (ridges, queries, features); normal equations or their dual, whichever is smaller."""
    centre, spread = inputs.mean(0), inputs.std(0, correction=0)
    # An input that never varies carries nothing: round-off must not be blown up to unit variance.
    scale = torch.where(spread > 1e-10 * inputs.abs().amax(0), spread, torch.inf)
    known, asked = (inputs - centre) / scale, (queries - centre) / scale
    mean, count, num_inputs = targets.mean(0), *inputs.shape
    dual = num_inputs > count
    gram = (known @ known.T if dual else known.T @ known) / count
    ridge = (amounts * num_inputs)[:, None, None] * torch.eye(len(gram), dtype=gram.dtype)
    right = targets - mean if dual else known.T @ (targets - mean) / count
    left = asked @ known.T / count if dual else asked
    return mean + left @ psd_solve(gram + ridge, right.expand(len(amounts), -1, -1), "ridge regression")
