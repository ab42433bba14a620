from __future__ import annotations

import pytest
from sweep_world import leave_sweep

from eaip_prob.reports import charts, read_runs, sections
from eaip_prob.reports.charts import Axis
from eaip_prob.reports.page import MOST_FIGURES, MOST_SETTINGS

LENGTHS = (10, 50, 100)
X = {f"rmse/both/eaip/{n}": 50.0 / n for n in LENGTHS} | {"novel/success/50x50": 0.9, "novel/success/50x400": 0.8}


def shifted(amount: float) -> dict[str, float]:
    return {name: value + amount for name, value in X.items()}


def swept(folder, num_settings: int, num_seeds: int, **more):
    values = {
        f"m{n}": {seed: shifted(0.01 * n + 0.003 * seed * n) for seed in range(num_seeds)} for n in range(num_settings)
    }
    return sections(read_runs(leave_sweep(folder / "sweep", values, **more)))


def test_metrics_become_lines_and_rows(tmp_path):
    (section,) = swept(tmp_path, 2, 2)
    found = charts.charts(section, [*X, "seconds/total", "gain/10/low", "gain/10/high", "alone"])
    shape = [(chart.prefix, chart.is_line, list(chart.values)) for chart in found]
    assert shape == [
        ("rmse/both/eaip", True, ["10", "50", "100"]),
        ("novel/success", False, ["50x50", "50x400"]),
        ("seconds", False, ["total"]),
        ("gain/10", False, ["low", "high"]),
        ("", False, ["alone"]),
    ]
    assert set(found[0].values["10"]) == {"model=m0", "model=m1"}
    (only,) = charts.charts(section, ["rmse/both/eaip/10"])
    assert not only.is_line


@pytest.mark.parametrize(("num_settings", "num_seeds", "num_bands"), [(2, 1, 0), (3, 3, 3), (1, 3, 1), (8, 2, 0)])
def test_a_line_a_setting_with_its_interval(tmp_path, num_settings, num_seeds, num_bands):
    (section,) = swept(tmp_path, num_settings, num_seeds)
    (chart,) = charts.charts(section, [f"rmse/both/eaip/{n}" for n in LENGTHS])
    (ax,) = charts._figure(chart, Axis("samples seen", "px")).axes
    names = [line.get_label() for line in ax.lines]
    assert len(names) == num_settings
    value = next(row.value for row in section.rows if row.metric == "rmse/both/eaip/50")
    assert list(ax.lines[0].get_xdata()) == list(LENGTHS) and ax.lines[0].get_ydata()[1] == value.mean
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("samples seen", "rmse of the future (px)")
    bars = num_settings * len(LENGTHS) if num_settings > 4 and num_seeds > 1 else 0
    assert len(ax.collections) == num_bands + bars


def test_intervals_are_drawn_where_they_are(tmp_path):
    (section,) = swept(tmp_path, 2, 2)
    (chart,) = charts.charts(section, ["novel/success/50x50", "novel/success/50x400"])
    (ax,) = charts._figure(chart, Axis()).axes
    value = {row.setting.label: row.value for row in section.rows if row.metric == "novel/success/50x400"}["model=m1"]
    ends = [tuple(path.vertices[:, 0]) for lines in ax.collections for path in lines.get_paths()]
    assert (value.low, value.high) in ends and len(ends) == 4
    assert [text.get_text() for text in ax.get_yticklabels()] == ["50x50", "50x400"]
    assert ax.get_xlabel() == "share of plans that pass"


def test_wide_intervals_do_not_hide_the_lines(tmp_path):
    values = {"a": {0: {"nll/1": 1.0, "nll/2": 2.0}, 1: {"nll/1": 1.1, "nll/2": 9.0}}}
    (section,) = sections(read_runs(leave_sweep(tmp_path, values)))
    (chart,) = charts.charts(section, ["nll/1", "nll/2"])
    (ax,) = charts._figure(chart, Axis()).axes
    low, high = ax.get_ylim()
    assert low <= 1.05 and 5.5 <= high < 12.0


def test_no_more_settings_than_can_be_told_apart(tmp_path):
    (section,) = swept(tmp_path, MOST_SETTINGS + 3, 1)
    (chart,) = charts.charts(section, [f"rmse/both/eaip/{n}" for n in LENGTHS])
    (ax,) = charts._figure(chart, Axis()).axes
    assert len(ax.lines) == MOST_SETTINGS


def test_long_labels_stay_beside_the_axes(tmp_path):
    key = "predictor.model.something.with_a_long_name.and_another_one"
    (section,) = swept(tmp_path, 3, 2, key=key)
    (chart,) = charts.charts(section, [f"rmse/both/eaip/{n}" for n in LENGTHS])
    figure = charts._figure(chart, Axis())
    figure.draw_without_rendering()
    legend = figure.legends[0].get_window_extent()
    axes = figure.axes[0].get_window_extent()
    assert legend.x0 >= axes.x1 and legend.x1 <= figure.bbox.x1 + 1
    assert axes.width > 0.9 * 3.3 * figure.dpi


def test_files_are_named_after_what_they_show_and_old_ones_leave(tmp_path):
    made = swept(tmp_path, 2, 2)
    names = charts.draw(tmp_path, made, ["rmse/*", "novel/*"], {})
    assert names == {"passing_over": ["rmse_both_eaip", "novel_success"]}
    (tmp_path / "report.md").write_text("![x](figures/rmse_both_eaip.png) ![x](figures/novel_success.png)")
    (tmp_path / "figures" / "mine.png").write_text("")
    charts.draw(tmp_path, made, ["novel/*"], {})
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"novel_success.png", "mine.png"}


def test_no_more_figures_than_a_page_bears_and_none_overwrites_another(tmp_path, monkeypatch):
    monkeypatch.setattr(charts, "save_figure", lambda *_: None)
    metrics = {f"a{n}/x": 1.0 for n in range(MOST_FIGURES + 3)}
    made = sections(read_runs(leave_sweep(tmp_path / "s", {"a": {0: metrics}})))
    assert len(charts.draw(tmp_path, made, ["*"], {})["passing_over"]) == MOST_FIGURES
    metrics = {"a/b/x": 1.0, "a_b/x": 1.0, "a/b/1": 1.0, "a/b/2": 1.0}
    made = sections(read_runs(leave_sweep(tmp_path / "t", {"a": {0: metrics}}, experiment="odd")))
    names = charts.draw(tmp_path, made, ["*"], {})["odd"]
    assert len(set(names)) == 3


def test_experiments_have_figures_of_their_own(tmp_path):
    for name in ("timing", "benchmarks/core"):
        leave_sweep(tmp_path / name, {"a": {0: X}}, experiment=name)
    names = charts.draw(tmp_path, sections(read_runs(tmp_path)), ["rmse/*"], {})
    assert names == {"benchmarks/core": ["benchmarks_core_rmse_both_eaip"], "timing": ["timing_rmse_both_eaip"]}


def test_nothing_finished_draws_nothing(tmp_path):
    made = sections(read_runs(leave_sweep(tmp_path, {"a": {0: None}})))
    assert charts.draw(tmp_path, made, ["*"], {}) == {"passing_over": []}
