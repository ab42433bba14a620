"""When may the robot act: readiness from the uncertainty of what is left of its predicted motion.

The measure is the predicted standard deviation of the remaining path in the path's own units, so that a threshold can
be read off the task (how far off a gripper may be). The robot is ready when all signals are under their thresholds and
have stayed there for a while; a rise takes readiness back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite, check_shape
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.forecast import Prediction


def remaining_deviation(
    prediction: Prediction, now: float | Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch signals"]:
    """Standard deviation of what is left of a predicted path, per signal: sqrt(mean of the variances after `now`).

    Args:
        prediction: of one motion or a batch.
        now: (*#batch,) or one number, seconds on the clock of `prediction.time`.

    Returns:
        (*batch, D), in each signal's unit: root mean of the marginal variances of the samples with time > now; of the
        last sample where none is.

    Raises:
        ShapeError: `now` does not fit the batch of the prediction.
        InputError: `now` is not finite, or a predicted variance is negative or NaN.

    Example:
        >>> from eaip_prob import DemonstrationSet, InteractionPredictor
        >>> from eaip_prob.phase import ElapsedClock
        >>> from eaip_prob.tasks.passing_over import PassingOver
        >>> task = PassingOver()
        >>> demonstrations = DemonstrationSet([*task.demonstrations(1, seed=0)], [0] * 4 + [1] * 5)
        >>> predictor = InteractionPredictor(target="human", phase=ElapsedClock()).fit(demonstrations)
        >>> test = task.demonstrations(1, seed=1)[0]
        >>> early, late = (remaining_deviation(predictor.predict(test.human.first(n)), 0.5) for n in (5, 60))
        >>> early.shape, bool((late < early).all())
        (torch.Size([2]), True)
    """
    moment, variance = _checked_now(now), prediction.variance
    _common_batch("now", moment.shape, "the prediction", variance.shape[:-2])
    after = prediction.time > moment[..., None]
    last = prediction.time == prediction.time.amax(-1, keepdim=True)
    counted = torch.where(after.any(-1, keepdim=True), after, last)[..., None]
    mean = torch.where(counted, variance, 0.0).sum(-2) / counted.sum(-2)
    if not bool((mean >= 0).all()):
        raise InputError(
            f"Expected predicted variances of at least 0, got a mean of {float(mean.min()):.3g} over what remains. "
            "Check the demonstrations and the noise of the predictor."
        )
    return mean.sqrt()


@dataclass(frozen=True, eq=False)
class ReadinessState:
    """What `Readiness.step` remembers between two predictions.

    Args:
        since: (*batch,), seconds, from when on the deviation has been under the threshold; infinite where it is not.
        time: (*batch,), seconds, of the last step; minus infinity before the first.
    """

    since: Float[Tensor, "*batch"]
    time: Float[Tensor, "*batch"]


@dataclass(frozen=True, eq=False)
class Readiness:
    """The rule: ready while the remaining deviation of every signal has been under its threshold for `hold` seconds.

    The state is passed in and returned; `init()` starts a motion, or a batch of them. A time before the last step is
    refused: it is a late frame's own time in place of the present, or the state of another motion, with which the robot
    would act too early.

    Args:
        threshold: one number for all signals or (D,), in the signals' units, above zero.
        hold: seconds, at least 0; 0 is ready at once.

    Raises:
        InputError: a threshold or hold that is not finite or not in range.
        ShapeError: thresholds with more than one axis.

    Example:
        >>> from eaip_prob import DemonstrationSet, InteractionPredictor
        >>> from eaip_prob.phase import ElapsedClock
        >>> from eaip_prob.tasks.passing_over import PassingOver
        >>> task = PassingOver()
        >>> demonstrations = DemonstrationSet([*task.demonstrations(1, seed=0)], [0] * 4 + [1] * 5)
        >>> predictor = InteractionPredictor(target="human", phase=ElapsedClock()).fit(demonstrations)
        >>> seen = task.demonstrations(1, seed=1)[0].human
        >>> rule = Readiness(threshold=200.0, hold=0.3)
        >>> state, answers = rule.init(), []
        >>> for n in (20, 40, 60):
        ...     ready, state = rule.step(predictor.predict(seen.first(n)), seen.time[n - 1], state)
        ...     answers.append(bool(ready))
        >>> answers
        [False, False, True]
    """

    threshold: float | Sequence[float] | Float[Tensor, "*#signals"]
    hold: float = 0.0

    def __post_init__(self) -> None:
        threshold, hold = as_float64("threshold", self.threshold), as_float64("hold", self.hold)
        if threshold.ndim > 1:
            raise ShapeError(f"Expected threshold as one number or (D,) of them, got shape {tuple(threshold.shape)}.")
        if not bool(((threshold > 0) & threshold.isfinite()).all()):
            raise InputError(f"Expected threshold above zero and finite, in the signals' units, got {self.threshold}.")
        if hold.ndim or not 0 <= float(hold) < float("inf"):
            raise InputError(f"Expected hold as one finite number of seconds, at least 0, got {self.hold}.")
        object.__setattr__(self, "threshold", threshold)
        object.__setattr__(self, "hold", float(hold))

    def init(self) -> ReadinessState:
        """The state before the first prediction; it takes on the batch of the predictions."""
        infinite = torch.tensor(torch.inf, dtype=torch.float64)
        return ReadinessState(infinite, -infinite)

    def step(
        self, prediction: Prediction, now: float | Float[Tensor, "*#batch"], state: ReadinessState
    ) -> tuple[Bool[Tensor, "*batch"], ReadinessState]:
        """(whether the robot may act, the next state).

        Args:
            prediction: what is predicted now.
            now: (*#batch,) or one number, seconds on the clock of `prediction.time`, not before the last step.
            state: from `init` or the last step.

        Raises:
            InputError: `now` is not finite or before the last step, or a predicted variance is negative.
            ShapeError: batches of the prediction, `now` and the state that do not fit, or another number of thresholds
                than of signals.
        """
        moment = _checked_now(now)
        under = self.is_under(remaining_deviation(prediction, moment))
        batch = _common_batch("state", state.since.shape, "the prediction and now", under.shape)
        if bool((moment < state.time).any()):
            raise InputError(
                f"Expected now not before the last step, got {float((state.time - moment).amax()):.6g} s before it. "
                "Pass the present time, not a late frame's own; start another motion with init()."
            )
        since = torch.where(under, torch.minimum(state.since, moment), torch.inf).expand(batch)
        return self.is_held(since, moment), ReadinessState(since, moment.expand(batch))

    def is_under(self, deviation: Float[Tensor, "*batch signals"]) -> Bool[Tensor, "*batch"]:
        """Whether the deviations of all signals are under their thresholds.

        Raises:
            ShapeError: another number of thresholds than of signals.
        """
        threshold = as_float64("threshold", self.threshold)
        if threshold.ndim and threshold.shape != deviation.shape[-1:]:
            raise ShapeError(
                f"Expected one threshold or {deviation.shape[-1]} of them, one for each signal, got {len(threshold)}."
            )
        return (deviation < threshold).all(-1)

    def is_held(self, since: Float[Tensor, "*#batch"], time: Float[Tensor, "*#batch"]) -> Bool[Tensor, "*batch"]:
        """Whether `hold` seconds have passed; a time that misses them by round-off counts."""
        round_off = 4.0 * torch.finfo(torch.float64).eps * (time.abs() + self.hold)
        return time - since >= self.hold - round_off


def first_ready(
    deviation: Float[Tensor, "*batch time signals"],
    time: Float[Tensor, "*#batch time"],
    threshold: float | Sequence[float] | Float[Tensor, "*#signals"],
    hold: float = 0.0,
) -> Float[Tensor, "*batch"]:
    """The first time from which `Readiness` says ready until the end of the record; infinite where there is none.

    Args:
        deviation: (*batch, T, D), remaining deviation at each time, in the signals' units; a single signal keeps its
            axis: `deviation[..., None]`.
        time: (*#batch, T), seconds, strictly increasing.
        threshold: one number for all signals or (D,), in the signals' units, above zero.
        hold: seconds, at least 0.

    Returns:
        (*batch,), seconds: a time of the record, or infinity.

    Raises:
        ShapeError: shapes that do not fit.
        InputError: deviations that are negative or not finite, times that do not increase, or a threshold or hold out
            of range.

    Example:
        >>> time = torch.tensor([0.0, 0.5, 1.0, 1.5, 2.0])
        >>> deviation = torch.tensor([[9.0], [1.0], [5.0], [2.0], [1.0]])
        >>> first_ready(deviation, time, threshold=3.0).item(), first_ready(deviation, time, 3.0, hold=0.5).item()
        (1.5, 2.0)
        >>> first_ready(deviation, time, threshold=3.0, hold=1.0).item()
        inf
    """
    rule = Readiness(threshold, hold)
    deviation, time = _checked_record(deviation, time)
    under = rule.is_under(deviation)
    stays = under.flip(-1).to(torch.int64).cumprod(-1).flip(-1).bool()
    since = torch.where(stays, time, torch.inf).amin(-1, keepdim=True)
    return torch.where(stays & rule.is_held(since, time), time, torch.inf).amin(-1)


def _checked_record(deviation: Tensor, time: Tensor) -> tuple[Tensor, Tensor]:
    """Deviations and times as float64."""
    deviation, time = as_float64("deviation", deviation), as_float64("time", time)
    if time.ndim == 0 or time.shape[-1] == 0:
        raise ShapeError(f"Expected time with shape (*batch, T), T at least 1, got {tuple(time.shape)}.")
    check_shape("deviation", deviation, [time.shape[-1], "signals"])
    if time.ndim > 1:
        _common_batch("time", time.shape[:-1], "deviation", deviation.shape[:-2])
    check_finite("time", time, advice="Drop the samples that have none.")
    check_finite("deviation", deviation, advice="Drop the samples that have none.")
    if bool((time.diff(dim=-1) <= 0).any()):
        raise InputError("Expected strictly increasing time, in seconds. Sort the record and drop repeated times.")
    if bool((deviation < 0).any()):
        raise InputError(
            f"Expected deviations of at least 0, got {float(deviation.min()):.3g}. Pass standard deviations."
        )
    return deviation, time


def _checked_now(now: float | Tensor) -> Tensor:
    moment = as_float64("now", now)
    check_finite("now", moment, advice="Pass seconds on the clock of the prediction's times.")
    return moment


def _common_batch(name: str, shape: Sequence[int], other: str, wanted: Sequence[int]) -> torch.Size:
    try:
        return torch.broadcast_shapes(shape, wanted)
    except RuntimeError as error:
        raise ShapeError(
            f"Expected {name} with a batch that fits {other}, {tuple(wanted)}, got {tuple(shape)}. "
            "Give one for each motion."
        ) from error
