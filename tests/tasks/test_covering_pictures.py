from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from covering_world import case, perception, recorded, room, shared

from eaip_prob.data.frames import Intrinsics
from eaip_prob.detection import Detections
from eaip_prob.perception.hands import HandState, hands_to_trajectory
from eaip_prob.recording import AbstractRunLogger, RerunLogger
from eaip_prob.recording.records import Curves, Layout, Text
from eaip_prob.recording.scene_records import ImageBoxes, Surface
from eaip_prob.recording.sensor_records import CameraImages
from eaip_prob.robot import baxter_left_arm
from eaip_prob.simulation import Kinect, KinectModel
from eaip_prob.tasks.bag_covering import outcome_pictures, path_pictures, pictures, replaying, study, workflow_picture
from eaip_prob.tasks.bag_covering.judging import CLEAR
from eaip_prob.tasks.bag_covering.outcome import KINDS, Run
from eaip_prob.tasks.bag_covering.perceiving import Instant
from eaip_prob.tasks.bag_covering.recording import record_run, recording_files
from eaip_prob.tasks.bag_covering.running import Job, Result, Setting, performed

NAMES = ["stepladder", "folding_table", "office_chair", "brown_bookshelf", "end_table", "chair_4_legged"]


@pytest.fixture
def kept(monkeypatch):
    """Figures by name, instead of files."""
    figures: dict[str, Any] = {}
    for module in (outcome_pictures, path_pictures, workflow_picture):
        monkeypatch.setattr(module, "save_figure", lambda figure, folder, name: figures.update({name: figure}))
    return figures


@pytest.fixture
def cameras(monkeypatch):
    """Small ones, which are quickly rendered."""
    lens = Intrinsics(96, 54, 53.0, 53.0, 47.5, 26.5)
    model = KinectModel(Intrinsics(64, 53, 45.7, 45.7, 31.5, 26.0), lens, (-0.052, 0.0, 0.0))
    at = perception().detecting
    units = tuple(Kinect(name, model, at.T_world_camera) for name in ("left", "right"))
    monkeypatch.setattr(perception(), "cameras", units, raising=False)
    monkeypatch.setattr(replaying, "COLOR_SIZE", (96, 54))
    return units


def result(kind: str, near: float = 0.2, seconds: float = 6.0) -> Result:
    time = np.arange(60) / 10.0
    gripper = np.stack([np.full(60, 0.45), np.linspace(-0.6, 0.5, 60), 0.2 * np.sin(time)], -1)
    times = np.arange(1.0, seconds, 0.2)
    deviation = np.stack([times, 0.1 * np.exp(-0.3 * times)], -1)
    distance = np.where(np.arange(60) == 30, near, 2.0 * CLEAR)
    run = Run(kind, "", 6.0, 0.9, near, 2.0, time, gripper, distance, deviation)
    hands = tuple(
        HandState(float(t), np.zeros((2, 3)), np.tile(1e-6 * np.eye(3), (2, 1, 1)), np.ones(2, bool)) for t in time
    )
    return Result(run, hands, Detections.none((96, 54)))


def job(method: str, name: str = "brown_bookshelf", number: int = 0, setting: Setting | None = None) -> Job:
    return Job(case(name, number), method, setting, name=f"{method}: {name} {number}")  # pyright: ignore


def test_paths_are_averaged_at_the_same_share_of_their_duration():
    slow, fast = np.linspace(0.0, 20.0, 81), np.linspace(0.0, 5.0, 41)
    both = [path_pictures.by_phase(np.stack([t**2 / t[-1] ** 2, t], -1), t) for t in (slow, fast)]
    np.testing.assert_allclose(both[0][:, 0], both[1][:, 0], atol=1e-3)
    assert both[0][-1, 1] == 20.0


def test_the_band_is_measured_across_the_path():
    """Paths that differ along themselves only have none, and paths side by side their distance."""
    share = np.linspace(0.0, 1.0, 101)
    line = np.stack([share, share], -1) / np.sqrt(2.0)
    aside = np.array([-1.0, 1.0]) / np.sqrt(2.0)
    outline = path_pictures.band(np.stack([line + offset * aside for offset in (-0.3, 0.0, 0.3)]))
    upper, lower = outline[:101], outline[101:][::-1]
    np.testing.assert_allclose(np.linalg.norm(upper - lower, axis=1), 2.0 * 0.3 * np.sqrt(2.0 / 3.0))
    along = path_pictures.band(np.stack([line + 0.2 * line[-1], line]))
    np.testing.assert_allclose(along[:101], along[101:][::-1], atol=1e-12)


def test_collisions_are_red_where_something_was_near(kept):
    results = {job("ip"): result("collided", near=0.5 * CLEAR), job("eaip"): result("covered")}
    path_pictures.draw_behaviour(Path(), "fig", results, ["ip", "eaip"], ["brown_bookshelf", "stepladder"])
    ip, eaip = kept["fig"].axes[:2]
    red = [line for line in ip.lines if line.get_color() == "#d00000"]
    near = np.flatnonzero(np.isfinite(red[0].get_xdata().astype(float)))
    assert near.tolist() == [30]
    assert not [line for line in eaip.lines if line.get_color() == "#d00000"]
    assert "collided" in ip.get_title() and "0 of 1" in ip.get_title() and "1 of 1" in eaip.get_title()


def test_quartiles_stop_where_most_runs_have_ended():
    runs = [np.stack([np.arange(1.0, end, 0.2), np.full(len(np.arange(1.0, end, 0.2)), level)], -1)
            for end, level in ((3.01, 0.1), (3.01, 0.2), (9.01, 0.3), (5.01, 0.4))]  # fmt: skip
    time, quartiles = outcome_pictures.deviation_quartiles([*runs, np.zeros((0, 2))])
    assert time[0] == 1.0 and round(time[-1], 6) == 5.0
    np.testing.assert_allclose(quartiles[0], np.quantile([0.1, 0.2, 0.3, 0.4], [0.25, 0.5, 0.75]))
    np.testing.assert_allclose(quartiles[-1], np.quantile([0.3, 0.4], [0.25, 0.5, 0.75]))
    assert outcome_pictures.deviation_quartiles([])[0].shape == (0,)


def test_readiness_is_not_drawn_behind_the_end_of_the_partners_motion(kept):
    one = job("ip")
    outcome_pictures.draw_when_to_act(Path(), {one: result("held", seconds=40.0)}, ["ip"])
    (line, threshold) = kept["when_to_act"].axes[0].lines
    assert line.get_xdata().max() <= one.case.motion.duration
    assert threshold.get_ydata()[0] == pytest.approx(6.5)


def test_bars_are_shares_of_an_objects_runs(kept):
    kinds = {("ip", "brown_bookshelf", 0): "covered", ("ip", "brown_bookshelf", 1): "collided",
             ("ip", "folding_table", 0): "held", ("eaip", "folding_table", 0): "aborted"}  # fmt: skip
    results = {job(*key): result(kind) for key, kind in kinds.items()}
    shares = outcome_pictures.outcome_shares(results, "ip", ["brown_bookshelf", "folding_table", "all"])
    assert shares[0].tolist() == [0.5, 0.0, 0.5, 0.0, 0.0]
    assert shares[1, KINDS.index("held")] == 1.0
    np.testing.assert_allclose(shares.sum(1), 1.0)
    assert shares[2, KINDS.index("covered")] == pytest.approx(1 / 3)
    outcome_pictures.draw_outcomes(Path(), results, NAMES)
    ax = kept["success"].axes[0]
    assert [text.get_text() for text in ax.get_yticklabels()] == ["folding table", "brown bookshelf", "all"]
    first = [bar for bar in ax.patches if bar.get_y() < 0.0]  # folding table
    assert [bar.get_width() for bar in first if bar.get_width() > 0.0] == [100.0]


def test_errors_are_in_centimetres(kept):
    metrics = {"rmse_to_final/ip/10": 0.12, "rmse_to_final/ip/100": 0.0, "success_at/ip/10": 0.5, "other": 3.0}
    outcome_pictures.draw_final_error(Path(), metrics)
    outcome_pictures.draw_success_at(Path(), metrics)
    assert kept["fig_17b_rmse_to_final"].axes[0].lines[0].get_ydata().tolist() == [12.0]
    assert kept["success_at"].axes[0].lines[0].get_xydata().tolist() == [[10.0, 0.5]]


def test_words_of_the_workflow_stay_in_their_boxes(kept):
    workflow_picture.draw_workflow(Path())
    figure = kept["fig_12_workflow"]
    figure.draw_without_rendering()
    (ax,) = figure.axes
    boxes = [patch.get_window_extent() for patch in ax.patches if patch.get_width() > 2.0]
    words = [text.get_window_extent() for text in ax.texts if "\n" in text.get_text()]
    assert len(boxes) == len(words) == len(workflow_picture._BOXES)
    for box, word in zip(boxes, words, strict=True):
        assert box.x0 < word.x0 and word.x1 < box.x1 and box.y0 < word.y0 and word.y1 < box.y1


@pytest.mark.parametrize("methods", [["eaip"], ["ip", "eaip"]])
def test_the_legend_of_behaviour_hides_no_label(tmp_path, monkeypatch, methods):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    drawn = []
    monkeypatch.setattr(path_pictures, "save_figure", lambda figure, *_: drawn.append(figure))
    results = {job(method, name): result("covered") for method in methods for name in NAMES}
    path_pictures.draw_behaviour(tmp_path, "fig", results, methods, NAMES)
    (figure,) = drawn
    FigureCanvasAgg(figure).draw()
    legend = figure.legends[0].get_window_extent()
    assert all(ax.xaxis.label.get_window_extent().y0 > legend.y1 for ax in figure.axes if ax.get_xlabel())


def test_one_method_without_the_scene_is_compared_with_one_that_sees_it():
    assert pictures.methods_side_by_side(["eaip", "paper_ip", "mean"]) == ["paper_ip", "eaip"]
    assert pictures.methods_side_by_side(["paper_ip", "ip", "paper_eaip"]) == ["ip", "paper_eaip"]
    assert pictures.methods_side_by_side(["eaip"]) == ["eaip"] and pictures.methods_side_by_side(
        ["mean", "kernel"]
    ) == ["mean"]


def test_objects_have_looks_of_their_own():
    looks = path_pictures.thing_looks([*NAMES, "table_4_legged", "yellow_bookshelf"])
    assert len({(look["color"], look["linestyle"]) for look in looks.values()}) == 8


def test_a_file_for_each_object_and_the_first_run_that_went_to_the_end(tmp_path):
    jobs = [job(m, n, k) for m in ("ip", "eaip") for n in ("folding_table", "stepladder") for k in (0, 1, 2)]
    failed = {"eaip: stepladder 0": "held", "eaip: folding_table 2": "held"}
    results = {one: result(failed.get(one.name, "covered")) for one in reversed(jobs)}
    files = recording_files(tmp_path, results)
    assert {path.relative_to(tmp_path).as_posix(): one.name for path, one in files.items()} == {
        "recording.rrd": "eaip: stepladder 1",
        "recordings/folding_table.rrd": "eaip: folding_table 0",
    }
    only = recording_files(tmp_path, {one: result("held") for one in jobs[:2]})
    assert [one.name for one in only.values()] == ["ip: folding_table 0"]


def test_the_robot_is_whole_and_its_arm_reaches_the_gripper():
    one = case()
    tips = np.stack([one.motion.gripper[::60], np.broadcast_to(one.motion.still, one.motion.gripper[::60].shape)], 1)
    bodies = replaying.robot_bodies(one.site, tips, every=2)
    assert bodies is not None
    whole = bodies.whole(3)
    assert len(bodies.meshes) == -(-len(tips) // 2)
    assert len(bodies.still.triangles) + len(bodies.moving(2).triangles) == len(whole.triangles)
    np.testing.assert_allclose(bodies.still.area().sum() + bodies.moving(2).area().sum(), whole.area().sum())
    distance = np.linalg.norm(bodies.moving(2).vertices - tips[2, 0], axis=1).min()
    assert distance < 0.03  # m; the fingers' radius
    assert np.linalg.norm(bodies.moving(2).vertices - tips[0, 0], axis=1).min() > 0.05


def test_cameras_show_the_robot_as_it_stands(cameras):
    one = case()
    at = Instant(0.0, one.motion.hands[0], np.stack([one.motion.gripper[0], one.motion.still]))
    bodies = replaying.robot_bodies(one.site, np.stack([at.grippers]))
    assert bodies is not None
    seen = list(replaying.Cameras(perception(), one.site, 0).frames(at, bodies.meshes[0]))
    other = list(replaying.Cameras(perception(), one.site, 0).frames(at, bodies.meshes[0].at(z=5.0)))
    assert [frame.name for frame in seen] == ["left", "right"]
    assert seen[0].color.shape == (54, 96, 3)
    changed = np.abs(seen[0].color.astype(int) - other[0].color).max(-1) > 40
    assert 0.01 < changed.mean() < 0.5


class Keeping(AbstractRunLogger):
    def __init__(self):
        self.records: list[Any] = []

    def _write(self, record):
        self.records.append(record)

    def _finish(self):
        pass

    def of(self, kind: type, entity: str = "") -> list[Any]:
        return [it for it in self.records if isinstance(it, kind) and it.entity.startswith(entity)]


@pytest.mark.slow
def test_a_whole_run_is_recorded(cameras):
    logger = Keeping()
    run = record_run(logger, job("ip", setting=shared()), "| a |\n|---|")
    assert isinstance(logger.records[0], Layout)
    bags = [record.at.time for record in logger.of(Surface, "bag")]
    longer = np.ceil(len(run.time) / 300)
    np.testing.assert_allclose(np.diff(bags), 0.1 * longer, atol=1e-6)
    assert bags[-1] > run.time[-1] - 0.1 * longer
    assert {record.entity for record in logger.of(Surface)} > {"floor", "object", "robot/body", "robot/arm", "bag"}
    frames = [record.at.time for record in logger.of(CameraImages, "cameras/left")]
    np.testing.assert_allclose(np.diff(frames), 0.5 * longer, atol=1e-6)
    (first, *_) = logger.of(ImageBoxes)
    assert first.entity == "cameras/right" and 0.0 < first.boxes[0, 0] < 96.0
    curves = {record.entity: record for record in logger.of(Curves)}
    np.testing.assert_allclose(curves["deviation/expected"].values[:, 0], 100.0 * run.deviation[:, 1])
    np.testing.assert_allclose(curves["clearance/distance"].values.min(), 100.0 * run.near[::3].min())
    assert (np.diff(curves["phase/expected"].values[:, 0]) > -1e-9).all()
    texts = logger.of(Text)
    assert "watches" in texts[0].markdown and run.kind in texts[-1].markdown and "| a |" in texts[-1].markdown
    assert texts[-1].at.time == pytest.approx(run.duration)
    plans = {record.at.time for record in logger.records if getattr(record, "entity", "") == "plan/spread"}
    assert len(plans) == len(run.deviation)


@pytest.mark.slow
def test_a_recording_is_no_larger_than_can_be_handed_on(tmp_path, cameras, monkeypatch):
    full = tuple(dataclasses.replace(cameras[0], name=name, model=perception().detecting.model) for name in "abc")
    monkeypatch.setattr(perception(), "cameras", full, raising=False)
    monkeypatch.setattr(replaying, "COLOR_SIZE", (480, 270))
    with RerunLogger(tmp_path / "recording.rrd") as logger:
        record_run(logger, job("eaip", "stepladder", setting=shared()))
    assert 5e6 < logger.path_of_file.stat().st_size < 25e6


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::eaip_prob.errors.ExtrapolationWarning")
def test_all_figures_are_drawn(tmp_path, cameras):
    jobs = [
        job(method, name, setting=shared()) for method in ("ip", "eaip") for name in ("brown_bookshelf", "end_table")
    ]
    results = {one: performed(one) for one in jobs}
    seen = [
        study.Seen(one.case, hands_to_trajectory(found.hands), {"ours": shared().encoder.encode(found.detections)})
        for one, found in results.items()
        if one.method == "eaip"
    ]
    rows = list(study.table(shared().predictors, seen, baxter_left_arm(), ["ip", "eaip"]))
    cases = [one.case for one in jobs]
    pictures.draw_all(tmp_path, room(), recorded(), cases, results, rows, study.summary(rows))
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == {
        "fig_9_platform", "fig_10_training_objects", "fig_11_novel_objects", "fig_12_workflow",
        "fig_13_mean_demonstrations", "fig_14a_ip_paths", "fig_14b_eaip_paths", "fig_15_training_objects_behaviour",
        "fig_16_novel_objects_behaviour", "fig_17a_convergence", "fig_17b_rmse_to_final", "success", "success_at",
        "when_to_act",
    }  # fmt: skip
