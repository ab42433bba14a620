"""What fitting found, in words."""

from __future__ import annotations

from eaip_prob.slope import Slope
from eaip_prob.training import ENVIRONMENT, Fitted


def described(fitted: Fitted) -> str:
    """One statement a line: choices, what the environment and the human's motion tell of new groups, calibration."""
    if not fitted.names[ENVIRONMENT]:
        lines = [f"Chosen: {_choices(fitted)}.", *_motion(fitted, "the motion")]
    else:
        known = "the motion, the environment known,"
        lines = [_scene(fitted), f"With the environment: {_choices(fitted)}.", *_motion(fitted, known)]
        if fitted.alone is not None:
            lines += [f"Without it: {_choices(fitted.alone)}.", *_motion(fitted.alone, "the motion")]
    if fitted.num_folds == 0:
        lines.append("There is one group, so nothing could be left out: these are defaults, and not calibrated.")
    return "\n".join(lines)


def _scene(fitted: Fitted) -> str:
    features, gate = ", ".join(fitted.names[ENVIRONMENT]), fitted.gate
    if fitted.num_folds == 0:
        return f"Whether the environment ({features}) tells of new groups is not known; it is believed."
    if gate.value == 0.0:
        return f"The environment ({features}) tells nothing of the {fitted.target}'s motion in new groups: not used."
    explained = f"explains {_percent(gate.explained)} of the {fitted.target}'s variation in new groups"
    return f"The environment ({features}) {explained}{_believed(gate)}."


def _choices(fitted: Fitted) -> str:
    parts = [type(fitted.phase).__name__]
    if fitted.features is not None:
        parts.append(f"{type(fitted.features).__name__} ({len(fitted.features.names)})")
    parts.append(type(fitted.model).__name__)
    if fitted.num_folds:
        parts.append(f"standard deviations times {fitted.inflation**0.5:.2f} ({fitted.num_folds} folds)")
    return ", ".join(parts)


def _motion(fitted: Fitted, what: str) -> list[str]:
    """What each part of the human's motion adds, and the environment beside it."""
    trust, scene = fitted.trust, fitted.scene_trust
    lines = [
        f"  {_percent(share)} of {what} {_adds(slope, fitted.target)}."
        for share, slope in zip(trust.shares, trust.slopes, strict=True)
    ]
    lines += [
        f"  The environment, beside {_percent(share)} of the motion, {_adds(slope, fitted.target)}."
        for share, slope in zip(scene.shares, scene.slopes, strict=True)
    ]
    return lines


def _adds(slope: Slope, target: str) -> str:
    if slope.value == 0.0:
        return f"tells nothing of what follows of the {target}'s in new groups"
    return f"explains {_percent(slope.explained)} of what is left of the {target}'s{_believed(slope)}"


def _believed(slope: Slope) -> str:
    return "" if slope.value >= 0.995 else f", believed to {_percent(slope.value)}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
