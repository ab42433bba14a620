"""What a study of recorded motions says in words and tables."""

from __future__ import annotations

from collections.abc import Mapping

from eaip_prob.evaluation import Gain
from eaip_prob.tables import text_table
from eaip_prob.tasks.recorded.study import GAINS, Key, Study

_ADDED = {
    "ip_over_mean": "watching the motion",
    "eaip_over_environment": "watching the motion, the environment known,",
    "eaip_over_ip": "knowing the environment, the motion watched,",
    "eaip_kernel_over_eaip": "weighting the demonstrations by their environment",
    "eaip_over_paper_eaip": "this package's method instead of the published one",
}


def table(study: Study) -> str:
    """Scores of each method, a column for each score and percentage seen; Markdown."""
    summaries = study.summaries()
    short = {"rmse": "rmse", "nll": "nll", "coverage90": "cover"}
    rows = [
        {"method": name}
        | {f"{head} {p} %": summaries[name, p][score] for score, head in short.items() for p in study.percents}
        for name in study.methods
    ]
    return text_table(rows, digits=3)


def verdicts(gains: Mapping[Key, Gain], unit: str) -> str:
    """One sentence for each gain and percentage seen: whether its interval leaves zero out, and on which side.

    Example:
        >>> print(verdicts({("ip_over_mean", 20): Gain(2.0, 1.0, 3.0, 6)}, "px"))
        20 % seen: watching the motion helps: rmse changes by -2 px (-3 to -1).
    """
    lines = []
    for name in GAINS:
        for (key, percent), gain in gains.items():
            if key == name:
                lines.append(f"{percent} % seen: {_ADDED[name]} {_verdict(gain, unit)}")
    return "\n".join(lines)


def _verdict(gain: Gain, unit: str) -> str:
    low, high = 0.0 - gain.high, 0.0 - gain.low
    change = f"rmse changes by {0.0 - gain.mean:+.2g} {unit} ({low:+.2g} to {high:+.2g})."
    if gain.holds_zero:
        return f"does not help here as far as can be told: {change}"
    return f"{'helps' if gain.low > 0 else 'does harm'}: {change}"


def text(study: Study, unit: str, groups: str) -> str:
    """All of it: scores, what fitting chose in each fold, and the verdicts; Markdown.

    Args:
        study: what was measured.
        unit: of the target.
        groups: what the groups are, in the plural.
    """
    count = len(set(study.groups))
    return "\n\n".join(
        [
            f"Scores on the future of {len(study.groups)} motions (rmse in {unit}; 90 % intervals should cover 0.9)",
            table(study),
            f"Chosen on held-out {groups} of the training motions, for each fold",
            text_table(study.chosen),
            f"Does it help? 95 % intervals over {count} {groups}",
            verdicts(study.gains(), unit),
        ]
    )
