"""How much people vary in tempo, whether the environment explains it, and which clock copes.

Conditions are pairs of people (`tempo`: share of the variance of log T that the rectangle explains; `log_sd`: standard
deviation of log T) with each clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eaip_prob.config import build
from eaip_prob.methods import EAIP, ENVIRONMENT
from eaip_prob.parts import Part
from eaip_prob.tasks.sweeps.charts import LABELS, Chart, score_table
from eaip_prob.tasks.sweeps.measuring import BASELINES, SCORES, changed, measured

XLABEL = "s.d. of log T"
Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Condition:
    """One kind of people with one clock.

    Args:
        tempo: key of the setting `tempo`.
        clock: key of the setting `clocks`.
        log_sd: standard deviation of log T.
    """

    tempo: str
    clock: str
    log_sd: float

    @property
    def name(self) -> str:
        """Of its part."""
        return f"{self.tempo}-{self.clock}-{self.log_sd:g}"

    def key(self, score: str, percent: int, method: str = EAIP) -> str:
        """Of its metric: `rmse/dependent/marginal/0.4/50`, with `/environment` behind it for another method than eaip.

        Example:
            >>> Condition("dependent", "marginal", 0.4).key("rmse", 50, "ip")
            'rmse/dependent/marginal/0.4/50/ip'
        """
        key = f"{score}/{self.tempo}/{self.clock}/{self.log_sd:g}/{percent}"
        return key if method == EAIP else f"{key}/{method}"


def conditions(settings: Settings) -> Iterator[Condition]:
    """Every tempo, standard deviation and clock of the settings (`conf/timing.yaml`, plain)."""
    for tempo in settings["tempo"]:
        for log_sd in settings["log_sd"]:
            for clock in settings["clocks"]:
                yield Condition(tempo, clock, float(log_sd))


def parts(settings: Settings) -> list[Part]:
    """One part for each condition; a clock of None is the predictor's own choice."""
    shared = {name: settings[name] for name in ("num_train", "num_test", "percent_seen", "seed")}
    made = []
    for condition in conditions(settings):
        clock = settings["clocks"][condition.clock]
        tempo = {"tempo_sd": condition.log_sd, "tempo_dependence": settings["tempo"][condition.tempo]}
        task = {**settings["task"], "person": settings["task"]["person"] | tempo}
        predictor = changed(settings["predictor"], {} if clock is None else {"phase": clock})
        made.append(Part(condition.name, {**shared, "task": task, "predictor": predictor}))
    return made


def measure(part: Part) -> dict[str, float]:
    """Scores of one condition, `rmse/eaip/50`, on other motions over the rectangles that were demonstrated."""
    config = part.config
    task = build(config["task"])
    training = task.demonstrations(config["num_train"], config["seed"])
    test = task.demonstrations(config["num_test"], config["seed"], "test")
    return measured(config["predictor"], training, test, (EAIP, *BASELINES), config["percent_seen"])


def metrics(settings: Settings, results: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Flat metrics of all conditions, by `Condition.key`, from the results of their parts by name."""
    return {
        condition.key(score, percent, method): results[condition.name][f"{score}/{method}/{percent}"]
        for condition in conditions(settings)
        for score in SCORES
        for percent in settings["percent_seen"]
        for method in (EAIP, *BASELINES)
    }


def charts(settings: Settings, values: Mapping[str, float], percents: Sequence[int]) -> list[Chart]:
    """Error, density, coverage, and error relative to knowing the environment alone; a row of panels for each tempo.

    Args:
        settings: of the run.
        values: of `metrics`.
        percents: those to show.
    """
    places = [(tempo, percent) for tempo in settings["tempo"] for percent in percents]
    made = []
    for score, label in (LABELS | {"ratio": "rmse, eaip / environment alone"}).items():
        panels = {
            f"{tempo}, {percent} % seen": {
                clock: _line(settings, values, score, tempo, clock, percent) for clock in settings["clocks"]
            }
            for tempo, percent in places
        }
        made.append(Chart(score, score, XLABEL, label, panels, num_columns=len(percents)))
    return made


def report(settings: Settings, values: Mapping[str, float]) -> str:
    """One table for each score after the middle percentage, a row for each tempo and clock; Markdown."""
    percents = settings["percent_seen"]
    percent = percents[len(percents) // 2]
    text = []
    for score, label in LABELS.items():
        rows = [
            ({"tempo": tempo, "clock": clock}, _line(settings, values, score, tempo, clock, percent))
            for tempo in settings["tempo"]
            for clock in settings["clocks"]
        ]
        text += [f"eaip, {percent} % seen: {label}, over the {XLABEL}", score_table(rows)]
    return "\n\n".join(text)


def _line(
    settings: Settings, values: Mapping[str, float], score: str, tempo: str, clock: str, percent: int
) -> dict[float, float]:
    line = {}
    for log_sd in map(float, settings["log_sd"]):
        condition = Condition(tempo, clock, log_sd)
        if score == "ratio":
            rmse, alone = (values[condition.key("rmse", percent, method)] for method in (EAIP, ENVIRONMENT))
            line[log_sd] = rmse / alone
        else:
            line[log_sd] = values[condition.key(score, percent)]
    return line
