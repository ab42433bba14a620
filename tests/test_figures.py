from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from matplotlib.figure import Figure

from eaip_prob import figures
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.figures.paths import level_ellipses


def drawn(figure: Figure) -> Figure:
    figure.draw_without_rendering()
    return figure


def path(num_samples: int = 20) -> torch.Tensor:
    t = torch.linspace(0.0, 1.0, num_samples, dtype=torch.float64)
    return torch.stack([300.0 * t - 50.0, 170.0 * torch.sin(3.1 * t)], -1)


def score_figure() -> Figure:
    scores = {method: {50: 3.0 + i, 10: 5.0 + i, 100: 2.0} for i, method in enumerate(figures.METHOD_STYLES)}
    bands = {"left": {"ip": {10: (4.0, 8.0), 50: (3.0, 6.0)}}}
    return figures.score_lines({"left": scores, "right": scores}, "samples seen", "DTW distance (px)", bands=bands)


def coverage_figure() -> Figure:
    return figures.coverage_plot([0.5, 0.9], {"eaip": [0.4, 0.85], "paper_eaip": [0.1, 0.3]})


def pit_figure() -> Figure:
    draws = torch.rand(500, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return figures.pit_histogram({"eaip": draws, "ip": draws.square()})


def paths_figure() -> Figure:
    figure, axes = figures.new_figure(2)
    for ax, method in zip(axes, ("ip", "eaip"), strict=True):
        figures.paths_panel(
            ax,
            rectangle=(0.0, 0.0, 215.0, 125.0),
            demonstrations=path().expand(3, 20, 2) + 4.0,
            plans=path().expand(2, 20, 2),
            mean=path(),
            covariance=30.0 * torch.eye(2, dtype=torch.float64).expand(20, 2, 2),
            truth=path(31),
            observed=path()[:5],
            method=method,
            title=f"215 x 125 px, {method}",
        )
    figures.outside_legend(figure)
    return figure


@pytest.mark.parametrize("make", [score_figure, coverage_figure, pit_figure, paths_figure])
def test_nothing_overlaps_and_axes_are_labelled(make: object) -> None:
    figure = drawn(make())  # pyright: ignore[reportCallIssue]
    boxes = [ax.get_tightbbox() for ax in figure.axes] + [legend.get_window_extent() for legend in figure.legends]
    for i, one in enumerate(boxes):
        assert figure.bbox.padded(1.0).contains(*one.min) and figure.bbox.padded(1.0).contains(*one.max)
        assert not any(one.padded(-1.0).overlaps(other.padded(-1.0)) for other in boxes[i + 1 :])
    assert all(ax.get_xlabel() for ax in figure.axes)
    assert figure.axes[0].get_ylabel()


def test_lines_show_the_scores_sorted_in_the_methods_colour() -> None:
    figure = score_figure()
    line = next(line for line in figure.axes[1].lines if line.get_label() == "eaip")
    assert list(line.get_xdata()) == [10, 50, 100]
    assert list(line.get_ydata()) == [8.0, 6.0, 2.0]
    assert line.get_color() == figures.METHOD_STYLES["eaip"].color
    assert len(figure.axes[0].collections) == 1
    assert [text.get_text() for text in figure.legends[0].get_texts()] == list(figures.METHOD_STYLES)


def test_every_method_has_its_own_colour() -> None:
    names = [*figures.METHOD_STYLES, *(f"other {i}" for i in range(18))]
    styles = figures.method_styles(names)
    looks = {(style.color, style.line) for style in styles.values()}
    assert len({style.color for style in figures.METHOD_STYLES.values()}) == len(figures.METHOD_STYLES)
    assert len(looks) == len(names)
    with pytest.raises(InputError, match="at most 18"):
        figures.method_styles([*names, "one more"])


def test_pit_histogram_is_a_density() -> None:
    figure = pit_figure()
    heights = [[patch.get_height() for patch in ax.patches] for ax in figure.axes]
    assert all(sum(row) / len(row) == pytest.approx(1.0) for row in heights)
    assert heights[1][0] > 2.0


def test_ellipses_hold_their_share_of_draws() -> None:
    root = torch.tensor([[3.0, 0.0], [-4.0, 1.0]], dtype=torch.float64)
    mean = torch.tensor([[100.0, -20.0]], dtype=torch.float64)
    outline = level_ellipses(mean, (root @ root.mT)[None], 0.8, num_points=200)[0]
    draws = torch.randn(20_000, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64) @ root.mT + mean
    from matplotlib.path import Path as Outline

    share = Outline(outline.numpy()).contains_points(draws.numpy()).mean()
    assert abs(share - 0.8) < 4 * (0.8 * 0.2 / 20_000) ** 0.5 + 0.001


def test_save_figure_writes_one_whole_file(tmp_path: Path) -> None:
    written = figures.save_figure(coverage_figure(), tmp_path / "run", "fig03")
    assert written == tmp_path / "run" / "figures" / "fig03.png"
    first = written.read_bytes()
    assert first.startswith(b"\x89PNG")
    assert figures.save_figure(coverage_figure(), tmp_path / "run", "fig03").read_bytes() == first
    assert [entry.name for entry in written.parent.iterdir()] == ["fig03.png"]


def test_failed_drawing_keeps_the_old_file(tmp_path: Path) -> None:
    written = figures.save_figure(coverage_figure(), tmp_path, "fig03")
    before = written.read_bytes()
    broken = coverage_figure()
    broken.axes[0].set_title("$\\nosuchsymbol$")
    with pytest.raises(ValueError, match="nosuchsymbol"):
        figures.save_figure(broken, tmp_path, "fig03")
    assert written.read_bytes() == before
    assert [entry.name for entry in written.parent.iterdir()] == ["fig03.png"]


@pytest.mark.parametrize("name", ["", "a/b", "fig03.png", ".."])
def test_odd_file_names_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="plain file name"):
        figures.save_figure(coverage_figure(), tmp_path, name)


def test_bad_input_is_refused() -> None:
    _, (ax,) = figures.new_figure()
    with pytest.raises(InputError, match="at least one panel"):
        figures.score_lines({}, "x", "y")
    with pytest.raises(InputError, match="between 0 and 1"):
        figures.coverage_plot([0.5], {"ip": [50.0]})
    with pytest.raises(InputError, match="Select the scored samples"):
        figures.pit_histogram({"ip": torch.tensor([0.5, torch.nan])})
    with pytest.raises(InputError, match="mean path"):
        figures.paths_panel(ax, covariance=torch.eye(2)[None])
    with pytest.raises(InputError, match="level above 0"):
        figures.paths_panel(ax, mean=path(1), covariance=torch.eye(2)[None], level=90)
    with pytest.raises(ShapeError, match="a path"):
        figures.paths_panel(ax, truth=torch.zeros(4, 3))


@pytest.mark.slow
def test_no_pyplot_and_no_matplotlib_at_import() -> None:
    code = (
        "import sys, eaip_prob.figures as f; assert 'matplotlib' not in sys.modules; "
        "f.score_lines({'': {'ip': {1: 2.0}}}, 'x', 'y'); assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_panels_wrap_and_every_row_has_its_label():
    lines = {"eaip": {5: 1.0, 80: 2.0}}
    figure = figures.score_lines({str(number): lines for number in range(5)}, "x", "y", num_columns=3)
    assert len(figure.axes) == 5
    assert [bool(ax.get_ylabel()) for ax in figure.axes] == [True, False, False, True, False]
    with pytest.raises(InputError, match="num_columns"):
        figures.score_lines({"": lines}, "x", "y", num_columns=0)


def test_a_logarithmic_x_has_a_tick_at_every_x():
    figure = figures.score_lines({"": {"eaip": {5: 1.0, 20: 2.0}, "ip": {80: 3.0}}}, "x", "y", log_x=True)
    (ax,) = figure.axes
    assert ax.get_xscale() == "log" and ax.get_xticks().tolist() == [5, 20, 80]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["5", "20", "80"]
    assert figures.score_lines({"": {"eaip": {5: 1.0, 20: 2.0}}}, "x", "y").axes[0].get_xscale() == "linear"


def test_signed_log_keeps_negative_scores():
    (ax,) = figures.score_lines({"": {"eaip": {5: -3.0, 20: 3000.0}}}, "x", "y").axes
    figures.signed_log(ax)
    places = ax.transData.transform([(5, -30.0), (5, -3.0), (5, 0.0), (5, 3.0), (5, 3000.0)])[:, 1]
    assert (places[1:] > places[:-1]).all()
    assert places[3] - places[2] == pytest.approx(places[2] - places[1])
    assert places[4] - places[3] < 20 * (places[3] - places[2])


def test_a_name_that_comes_twice_takes_one_style() -> None:
    names = [f"clock {number}" for number in range(6)]
    assert figures.method_styles(names * 3) == figures.method_styles(names)
