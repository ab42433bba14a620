"""How many demonstrations it takes: each over a rectangle of its own, so that none is ever repeated.

Conditions are a number of demonstrations, a repetition (an independent set of training motions; a smaller number takes
the first of them) and a variant of the predictor. All are tested on the same motions over other rectangles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from eaip_prob.config import build
from eaip_prob.errors import InputError
from eaip_prob.evaluation import Gain, paired_gain
from eaip_prob.methods import EAIP
from eaip_prob.parts import Part
from eaip_prob.tasks.sweeps.charts import LABELS, Chart, score_table
from eaip_prob.tasks.sweeps.measuring import BASELINES, SCORES, changed, measured, scattered

XLABEL = "number of demonstrations"
Settings = Mapping[str, Any]
Summaries = Mapping[tuple[str, str, int], Gain]  # by (score, method, number of demonstrations)


@dataclass(frozen=True)
class Condition:
    """One fit.

    Args:
        variant: key of the setting `variants`.
        num: demonstrations.
        repetition: 0 upwards.
    """

    variant: str
    num: int
    repetition: int

    @property
    def name(self) -> str:
        """Of its part."""
        return f"{self.variant}-{self.num}-{self.repetition}"


def conditions(settings: Settings) -> Iterator[Condition]:
    """Every repetition, number and variant of the settings (`conf/few_demonstrations.yaml`, plain)."""
    for repetition in range(settings["repetitions"]):
        for num in settings["num_demonstrations"]:
            for variant in settings["variants"]:
                yield Condition(variant, num, repetition)


def methods(settings: Settings) -> list[str]:
    """What is compared: the variants, and the one called `eaip` with its blocks unobserved.

    Raises:
        InputError: no variant `eaip`, or one with the name of those baselines.
    """
    variants = list(settings["variants"])
    if EAIP not in variants or set(variants) & set(BASELINES):
        raise InputError(f"Expected variants with {EAIP!r} among them and none called {BASELINES}, got {variants}.")
    return [*BASELINES, *variants]


def parts(settings: Settings) -> list[Part]:
    """One part for each condition."""
    methods(settings)
    shared = {name: settings[name] for name in ("task", "lengths", "num_test", "percent_seen", "seed")}
    return [
        Part(
            condition.name,
            {
                **shared,
                "num": condition.num,
                "repetition": condition.repetition,
                "methods": [EAIP, *BASELINES] if condition.variant == EAIP else [EAIP],
                "predictor": changed(settings["predictor"], settings["variants"][condition.variant]),
            },
        )
        for condition in conditions(settings)
    ]


def measure(part: Part) -> dict[str, float]:
    """Scores of one condition: `rmse/eaip/50` whatever the variant."""
    config = part.config
    task = build(config["task"])
    test, training = (
        scattered(task, num, config["lengths"], config["seed"], stream)
        for num, stream in ((config["num_test"], 0), (config["num"], 1 + config["repetition"]))
    )
    return measured(config["predictor"], training, test, config["methods"], config["percent_seen"])


def summaries(settings: Settings, results: Mapping[str, Mapping[str, float]]) -> Summaries:
    """Mean over the repetitions with its 95 % interval, from the results of all parts by name."""
    summary = {}
    for method in methods(settings):
        variant, role = (EAIP, method) if method in BASELINES else (method, EAIP)
        for num in settings["num_demonstrations"]:
            rows = [results[Condition(variant, num, repetition).name] for repetition in range(settings["repetitions"])]
            for score in SCORES:
                values = [
                    over_cuts(score, [row[f"{score}/{role}/{p}"] for p in settings["percent_seen"]]) for row in rows
                ]
                scores = torch.tensor(values, dtype=torch.float64)
                summary[score, method, num] = paired_gain(scores, torch.zeros_like(scores), range(len(rows)))
    return summary


def over_cuts(score: str, values: Sequence[float]) -> float:
    """One number for all percentages seen: root mean square of rmse, mean of others.

    Example:
        >>> over_cuts("rmse", [1.0, 7.0]), over_cuts("nll", [1.0, 7.0])
        (5.0, 4.0)
    """
    if score == "rmse":
        return math.sqrt(sum(value**2 for value in values) / len(values))
    return sum(values) / len(values)


def metrics(summary: Summaries) -> dict[str, float]:
    """Flat metrics `rmse/eaip_kernel/40`, with `/low` and `/high` behind them where there are several repetitions."""
    flat = {}
    for (score, method, num), row in summary.items():
        key = f"{score}/{method}/{num}"
        flat[key] = row.mean
        if math.isfinite(row.low):
            flat |= {f"{key}/low": row.low, f"{key}/high": row.high}
    return flat


def charts(settings: Settings, summary: Summaries) -> list[Chart]:
    """Error, density and coverage against the number of demonstrations, a panel for each group of methods.

    A panel shows those of its methods that the run compares, so that variants can be left out of one.
    """
    compared = set(methods(settings))
    panels = {title: [name for name in shown if name in compared] for title, shown in settings["panels"].items()}
    made = []
    for score, label in LABELS.items():
        means = {title: {name: _line(settings, summary, score, name) for name in panels[title]} for title in panels}
        bands = {title: {name: _band(settings, summary, score, name) for name in panels[title]} for title in panels}
        made.append(Chart(score, score, XLABEL, label, means, bands, log_x=True))
    return made


def _line(settings: Settings, summary: Summaries, score: str, method: str) -> dict[float, float]:
    return {num: summary[score, method, num].mean for num in settings["num_demonstrations"]}


def _band(settings: Settings, summary: Summaries, score: str, method: str) -> dict[float, tuple[float, float]]:
    """The interval, empty where there is one repetition only."""
    rows = {num: summary[score, method, num] for num in settings["num_demonstrations"]}
    return {num: (row.low, row.high) for num, row in rows.items() if math.isfinite(row.low)}


def report(settings: Settings, summary: Summaries) -> str:
    """One table for each score, a row for each method; Markdown."""
    text = []
    for score, label in LABELS.items():
        rows = [({"method": name}, _line(settings, summary, score, name)) for name in methods(settings)]
        text += [f"{label}, by the {XLABEL}", score_table(rows)]
    return "\n\n".join(text)
