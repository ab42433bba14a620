from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rerun.chunk import RrdReader

from eaip_prob.config import build, conf_dir
from eaip_prob.errors import InputError
from eaip_prob.recording import Moment, RerunLogger

TIME = np.array([0.0, 0.15, 0.4, 0.55, 0.9])


def rows(path: Path, entity: str, component: str) -> list[tuple[tuple[float, int] | None, list[Any]]]:
    found: list[tuple[tuple[float, int] | None, list[Any]]] = []
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        values = batch.column(component).to_pylist()
        if chunk.is_static:
            found += [(None, value) for value in values]
            continue
        seconds = batch.column("time").cast("int64").to_numpy() * 1e-9
        counts = batch.column("samples_seen").to_numpy()
        found += [((round(float(s), 9), int(n)), v) for s, n, v in zip(seconds, counts, values, strict=True)]
    return found


def contents(path: Path) -> list[Any]:
    chunks = RrdReader(path).stream().to_chunks()
    return [(chunk.entity_path, chunk.to_record_batch().drop_columns(["rerun.controls.RowId"])) for chunk in chunks]


def compare(one: Path, other: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rerun", "rrd", "compare", str(one), str(other)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def record(path: Path, seed: int = 3, dims: int = 2, **options: Any) -> Path:
    noise = torch.randn(4, 5, dims, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    mean = noise.mean(0) + 100.0
    names = ["x", "y", "z"][:dims]
    with RerunLogger(path, "test", **options) as logger:
        logger.blueprint("plane" if dims == 2 else "space", {f"signals/{name}": f"{name} [px]" for name in names})
        logger.rectangle("object", 215, 125, corner=(10, 20))
        logger.path("human/truth", mean)
        for seen in (2, 4):
            at = Moment(seen, float(TIME[seen - 1]))
            band = mean - 5.0, mean + 5.0 / seen
            logger.prediction(
                "robot",
                TIME,
                mean + seen,
                names,
                at=at,
                lower=band[0],
                upper=band[1] + seen,
                samples=mean + noise + seen,
            )
        logger.text("metrics", f"seed {seed}")
    return path


def test_paths_keep_their_values_and_y_up(tmp_path):
    path = tmp_path / "recording.rrd"
    values = torch.tensor([[1.0, 20.0], [3.0, 45.0], [6.0, -7.0]], dtype=torch.float64)
    many = torch.stack([values, 2 * values])
    with RerunLogger(path) as logger:
        logger.path("human/truth", values, color=(1, 2, 3), radius=2.5, label="truth")
        logger.paths("human/all", many.numpy(), at=Moment(7, 0.35))
        logger.path("hand", [[0.1, 0.2, 0.3], [0.4, 0.5, 0.75]])
    assert rows(path, "/plane/human/truth", "LineStrips2D:strips") == [(None, [values.tolist()])]
    assert rows(path, "/plane/human/truth", "LineStrips2D:colors") == [(None, [0x010203FF])]
    assert rows(path, "/plane/human/truth", "LineStrips2D:radii") == [(None, [-2.5])]
    assert rows(path, "/plane/human/truth", "LineStrips2D:labels") == [(None, ["truth"])]
    assert rows(path, "/plane/human/all", "LineStrips2D:strips") == [((0.35, 7), many.tolist())]
    ((_, strips),) = rows(path, "/space/hand", "LineStrips3D:strips")
    np.testing.assert_allclose(strips[0], [[0.1, 0.2, 0.3], [0.4, 0.5, 0.75]], rtol=1e-6)
    ((_, (mirror,)),) = rows(path, "/plane", "Transform3D:mat3x3")
    np.testing.assert_array_equal(np.reshape(mirror, (3, 3)), np.diag([1.0, -1.0, 1.0]))


def test_boxes(tmp_path):
    path = tmp_path / "recording.rrd"
    with RerunLogger(path) as logger:
        logger.rectangle("object", 215, 125, corner=(10.0, -20.0))
        logger.box("bag", [0.0, 1.0, 2.0], [1.0, 1.5, 4.0], at=Moment(3, 0.5), label="bag")
    outline = [[10.0, -20.0], [225.0, -20.0], [225.0, 105.0], [10.0, 105.0], [10.0, -20.0]]
    assert rows(path, "/plane/object", "LineStrips2D:strips") == [(None, [outline])]
    assert rows(path, "/plane/object", "LineStrips2D:labels") == [(None, ["215 x 125 px"])]
    assert rows(path, "/space/bag", "Boxes3D:half_sizes") == [((0.5, 3), [[0.5, 0.25, 1.0]])]
    ((_, centre),) = rows(path, "/space/bag", "InstancePoses3D:translations") or rows(
        path, "/space/bag", "Boxes3D:centers"
    )
    assert centre == [[0.5, 1.25, 3.0]]


def test_series_and_intervals_stand_on_both_timelines(tmp_path):
    path = tmp_path / "recording.rrd"
    values = np.array([[0.1, 1.0], [0.2, 2.0], [0.4, 4.0]])
    with RerunLogger(path) as logger:
        logger.series("phase", TIME[:3], values, ["true", "estimate"], color=[(1, 2, 3), (4, 5, 6, 7)])
        logger.series("scores", [0.15, 0.9], [[9.5], [3.25]], ["rmse"], samples_seen=torch.tensor([20, 100]))
        logger.interval("signals/x/90", TIME[:2], torch.tensor([1.0, 2.0]), torch.tensor([3.0, 5.0]), name="90 %")
    assert rows(path, "/plots/phase", "Scalars:scalars") == [
        ((0.0, 1), [0.1, 1.0]),
        ((0.15, 2), [0.2, 2.0]),
        ((0.4, 3), [0.4, 4.0]),
    ]
    assert rows(path, "/plots/phase", "SeriesLines:names") == [(None, ["true", "estimate"])]
    assert rows(path, "/plots/phase", "SeriesLines:colors") == [(None, [0x010203FF, 0x04050607])]
    assert rows(path, "/plots/scores", "Scalars:scalars") == [((0.15, 20), [9.5]), ((0.9, 100), [3.25])]
    assert rows(path, "/plots/signals/x/90", "Scalars:scalars") == [((0.0, 1), [1.0, 3.0]), ((0.15, 2), [2.0, 5.0])]


@pytest.mark.parametrize("dims", [2, 3])
def test_a_prediction_is_a_picture_and_a_fan(tmp_path, dims):
    path = tmp_path / "recording.rrd"
    mean = np.arange(5 * dims, dtype=float).reshape(5, dims) ** 2
    samples = np.stack([mean + 1.0, mean - 2.0, mean + 4.0])
    at = Moment(3, 0.4)
    with RerunLogger(path) as logger:
        logger.prediction(
            "robot",
            torch.as_tensor(TIME),
            mean,
            ["x", "y", "z"][:dims],
            at=at,
            lower=mean - 1.0,
            upper=mean + 3.0,
            samples=samples,
            observed=mean[:3] + 7.0,
        )
    root, strips = ("/plane/robot", "LineStrips2D:strips") if dims == 2 else ("/space/robot", "LineStrips3D:strips")
    now = (0.4, 3)
    assert rows(path, f"{root}/mean", strips) == [(now, [mean.tolist()])]
    assert rows(path, f"{root}/samples", strips) == [(now, samples.tolist())]
    assert rows(path, f"{root}/observed", strips) == [(now, [(mean[:3] + 7.0).tolist()])]
    if dims == 2:
        ((when, (outline,)),) = rows(path, f"{root}/end_interval", strips)
        assert when == now
        assert (min(outline), max(outline)) == ([63.0, 80.0], [67.0, 84.0])
    fan = rows(path, "/plots/signals/y/robot_0003", "Scalars:scalars")
    assert fan == [((TIME[k], k + 1), [mean[k, 1], mean[k, 1] - 1.0, mean[k, 1] + 3.0]) for k in (2, 3, 4)]


def test_signals_that_are_no_points_have_a_fan_only(tmp_path):
    path = tmp_path / "recording.rrd"
    with RerunLogger(path) as logger:
        logger.prediction("arm", TIME, np.ones((5, 7)), [f"j{i}" for i in range(7)], at=Moment(1, 0.0))
        logger.prediction("quiet", TIME, np.ones((5, 2)), ["x", "y"], at=Moment(1, 0.0), curves=False)
    assert len(rows(path, "/plots/signals/j6/arm_0001", "Scalars:scalars")) == 5
    entities = {chunk.entity_path for chunk in RrdReader(path).stream().to_chunks()}
    assert not {e for e in entities if e.startswith(("/plane/arm", "/space", "/plots/signals/x"))}
    assert "/plane/quiet/mean" in entities


def test_text_and_arrays(tmp_path):
    path = tmp_path / "recording.rrd"
    with RerunLogger(path) as logger:
        logger.text("metrics", "| a |\n|---|", at=Moment(2, 0.1))
        logger.array("figure_5/dtw", torch.arange(6.0).reshape(2, 3), ["method", "samples seen"])
    assert rows(path, "/report/metrics", "TextDocument:text") == [((0.1, 2), ["| a |\n|---|"])]
    assert rows(path, "/report/metrics", "TextDocument:media_type") == [((0.1, 2), ["text/markdown"])]
    ((_, (tensor,)),) = rows(path, "/arrays/figure_5/dtw", "Tensor:data")
    assert tensor["shape"] == [2, 3]
    assert tensor["names"] == ["method", "samples seen"]
    assert tensor["buffer"] == list(range(6))


def test_arguments_are_copied_and_unchanged(tmp_path):
    path = tmp_path / "recording.rrd"
    values = torch.ones(3, 2, dtype=torch.float64)
    with RerunLogger(path) as logger:
        logger.path("a", values)
        assert torch.equal(values, torch.ones(3, 2, dtype=torch.float64))
        values.zero_()
    assert rows(path, "/plane/a", "LineStrips2D:strips") == [(None, [[[1.0, 1.0]] * 3])]


def test_one_seed_gives_equal_recordings_and_another_does_not(tmp_path):
    one, same = record(tmp_path / "a" / "one.rrd"), record(tmp_path / "b" / "two.rrd")
    other = record(tmp_path / "c" / "one.rrd", seed=4)
    assert len(contents(one)) > 10
    assert contents(one) == contents(same)
    assert contents(one) != contents(other)


@pytest.mark.slow
def test_rerun_itself_finds_them_equal(tmp_path):
    one, same = record(tmp_path / "a" / "one.rrd"), record(tmp_path / "b" / "two.rrd")
    other = record(tmp_path / "c" / "one.rrd", seed=4)
    equal = compare(one, same)
    assert equal.returncode == 0, equal.stderr
    assert compare(one, other).returncode == 1


def test_no_wall_clock_is_recorded(tmp_path):
    store = RrdReader(record(tmp_path / "one.rrd")).stream().to_chunks()
    assert {name for chunk in store for name in chunk.timeline_names} == {"time", "samples_seen"}
    assert not [chunk.entity_path for chunk in store if "properties" in chunk.entity_path]


def layouts(path: Path) -> list[dict[str, list[Any]]]:
    reader = RrdReader(path)
    all_found: list[dict[str, list[Any]]] = []
    for store in reader.blueprints():
        found: dict[str, list[Any]] = {}
        for batch in (chunk.to_record_batch() for chunk in reader.stream(store=store).to_chunks()):
            for name in batch.schema.names:
                if ":" in name:
                    found.setdefault(name, []).extend(sum(batch.column(name).to_pylist(), []))
        all_found.append(found)
    return all_found


def test_the_layout_is_in_the_file_from_the_start_and_fitted_at_the_end(tmp_path):
    found = layouts(record(tmp_path / "one.rrd"))
    assert len(found) == 2
    for layout in found:
        assert sorted(layout["ViewBlueprint:display_name"]) == ["Paths [px], y up", "Report", "x [px]", "y [px]"]
        assert set(layout["ViewBlueprint:space_origin"]) == {"/", "/report", "/plots/signals/x", "/plots/signals/y"}
        assert layout["TimePanelBlueprint:timeline"] == ["samples_seen"]
    (fitted,) = [layout for layout in found if "VisualBounds2D:range" in layout]
    (bounds,) = fitted["VisualBounds2D:range"]
    margin = 0.08 * 215
    np.testing.assert_allclose(bounds["x_range"], [10 - margin, 225 + margin], atol=1e-3)
    np.testing.assert_allclose(bounds["y_range"], [-145 - margin, -20 + margin], atol=1e-3)


@pytest.mark.parametrize(
    ("kind", "classes"),
    [("space", {"3D", "TimeSeries", "TextDocument"}), ("plots", {"TimeSeries", "TextDocument"})],
)
def test_the_kinds_of_layout(tmp_path, kind, classes):
    path = tmp_path / "recording.rrd"
    with RerunLogger(path) as logger:
        logger.blueprint(kind, {"scores": "rmse [m]"}, timeline="time")
        logger.series("scores", [0.5, 2.5], [[1.0], [2.0]], ["eaip"])
    for layout in layouts(path):
        assert set(layout["ViewBlueprint:class_identifier"]) == classes
        assert layout["TimePanelBlueprint:timeline"] == ["time"]


def test_no_layout_is_made_up(tmp_path):
    path = tmp_path / "recording.rrd"
    with RerunLogger(path) as logger:
        logger.text("metrics", "x")
    assert layouts(path) == []


def test_recordings_are_named_by_folder_and_file_or_by_the_caller(tmp_path):
    (default,) = RrdReader(record(tmp_path / "run7" / "recording.rrd")).recordings()
    assert (default.application_id, default.recording_id) == ("test", "run7-recording")
    (named,) = RrdReader(record(tmp_path / "b.rrd", recording_id="seed3")).recordings()
    assert named.recording_id == "seed3"


def test_a_run_that_raises_keeps_what_it_recorded(tmp_path):
    path = tmp_path / "recording.rrd"
    with pytest.raises(ZeroDivisionError), RerunLogger(path) as logger:
        logger.text("metrics", "before")
        raise ZeroDivisionError
    assert os.listdir(tmp_path) == ["recording.rrd"]
    assert rows(path, "/report/metrics", "TextDocument:text") == [(None, ["before"])]


@pytest.mark.slow
def test_a_killed_run_leaves_a_file_that_opens(tmp_path):
    script = (
        "import os, signal, sys\n"
        "from eaip_prob.recording import RerunLogger\n"
        "logger = RerunLogger(sys.argv[1])\n"
        "logger.text('metrics', 'before')\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    path = tmp_path / "recording.rrd"
    ended = subprocess.run([sys.executable, "-c", script, str(path)], timeout=60)
    assert ended.returncode == -9
    assert os.listdir(tmp_path) == ["recording.partial.rrd"]
    with pytest.warns(Warning, match="no footer"):
        left = rows(tmp_path / "recording.partial.rrd", "/report/metrics", "TextDocument:text")
    assert left == [(None, ["before"])]
    record(path)
    assert os.listdir(tmp_path) == ["recording.rrd"]


def test_an_older_recording_stays_until_the_new_one_is_complete(tmp_path):
    path = record(tmp_path / "recording.rrd")
    before = path.read_bytes()
    logger = RerunLogger(path)
    assert path.read_bytes() == before
    logger.close()
    logger.close()
    assert path.read_bytes() != before
    with pytest.raises(InputError, match="was closed"):
        logger.text("metrics", "late")


def test_two_loggers_do_not_mix(tmp_path):
    with RerunLogger(tmp_path / "a.rrd") as one, RerunLogger(tmp_path / "b.rrd") as other:
        one.text("metrics", "one")
        other.text("metrics", "other")
    assert rows(tmp_path / "a.rrd", "/report/metrics", "TextDocument:text") == [(None, ["one"])]
    assert rows(tmp_path / "b.rrd", "/report/metrics", "TextDocument:text") == [(None, ["other"])]


def test_a_path_of_another_kind_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"ends in '\.rrd', got '.*\.mcap'"):
        RerunLogger(tmp_path / "a.mcap")


def test_the_configurations_build(tmp_path):
    import yaml

    for file in sorted((conf_dir() / "recording").glob("*.yaml")):
        cfg = yaml.safe_load(file.read_text())
        with build(cfg, path=tmp_path / f"{file.stem}.rrd", application_id="test") as logger:
            logger.text("metrics", "x")
    assert os.listdir(tmp_path) == ["rerun.rrd"]


@pytest.mark.slow
def test_importing_the_package_imports_no_rerun():
    script = (
        "import sys, eaip_prob.recording as recording\n"
        "assert 'rerun' not in sys.modules\n"
        "assert recording.RerunLogger.__name__ == 'RerunLogger'\n"
        "assert 'rerun' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)
