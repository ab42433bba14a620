from __future__ import annotations

import errno
import functools
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import torch

from eaip_prob import Demonstration, DemonstrationSet, EnvironmentFeatures, InteractionPredictor, Trajectory
from eaip_prob.config import check_kinds
from eaip_prob.errors import (
    DataFileError,
    ExtrapolationWarning,
    HeldOutWarning,
    InputError,
    MissingDataError,
    ShapeError,
    StorageError,
)
from eaip_prob.observation import LinearObservation
from eaip_prob.phase import ElapsedClock
from eaip_prob.run_folder import RunFolder
from eaip_prob.runs import Experiment, experiment

ROOT = Path(__file__).resolve().parents[2]
SCENE = ("width", "height")
REFUSED = {"config.yaml", "environment.json", "error.txt"}
SMALL = ["num_train=3", "num_test=1", "num_plans=9", "samples_seen=[10]", "recording=none"]
SMALL += ["feature_errors=[0]", "feature_noises=[20]", "sample_noises=[0]"]


def motion(amount: float, seconds: float = 2.3, samples: int = 24) -> Demonstration:
    """A reach over a distance; the robot meets it and the scene tells the distance."""
    time = torch.linspace(0.0, seconds, samples, dtype=torch.float64)
    phase = time / seconds
    bell = phase**2 * (3.0 - 2.0 * phase)
    human = Trajectory(time, (5.0 + amount * bell)[:, None], ("x",))
    robot = Trajectory(time, torch.stack([1.0 - amount * bell, 0.2 * bell], -1), ("u", "v"))
    return Demonstration(human, robot, EnvironmentFeatures(SCENE, [amount, 200.0 + 30.0 * amount]))


def some(count: int = 6) -> DemonstrationSet:
    return DemonstrationSet([motion(1.0 + 0.3 * i) for i in range(count)], [i % 3 for i in range(count)])


def quick() -> InteractionPredictor:
    return InteractionPredictor(phase=ElapsedClock(), noise=0.01, environment_noise=0.05)


@pytest.fixture(scope="module")
def fitted() -> InteractionPredictor:
    return quick().fit(some())


@pytest.fixture(scope="module")
def new() -> Demonstration:
    return motion(1.75)


def beginning(new: Demonstration, samples: int = 8) -> Trajectory:
    assert new.human is not None
    return new.human.first(samples)


OBSERVED = {
    "tensor": (lambda seen: seen.values, InputError, "a Trajectory or a sequence of them, got Tensor. Make one with"),
    "array": (lambda seen: seen.values.numpy(), InputError, "a Trajectory or a sequence of them, got ndarray"),
    "demonstration": (lambda _: motion(1.0), InputError, "a Trajectory or a sequence of them, got Demonstration"),
    "mixed": (lambda seen: [seen, seen.values], InputError, "every member of the sequence as Trajectory, got Tensor"),
    "two signals": (
        lambda seen: Trajectory(seen.time, seen.values.expand(-1, 2), ("x", "y")),
        InputError,
        r"human signals \('x',\), as fitted, got \('x', 'y'\)",
    ),
    "infinite": (
        lambda seen: Trajectory(seen.time, seen.values * torch.inf, ("x",)),
        InputError,
        r"finite numbers in values, got inf at index \(0, 0\) \(8 such entries\)\. Mark missing samples",
    ),
    "time": (
        lambda seen: Trajectory(seen.time.flip(0), seen.values, ("x",)),
        InputError,
        r"strictly increasing time, got a step of -0\.1 s after sample \(0,\)\. Sort the samples",
    ),
    "unknown time": (
        lambda seen: Trajectory(seen.time * torch.nan, seen.values, ("x",)),
        InputError,
        "finite numbers in time, got nan .* Leave out samples whose time is unknown",
    ),
    "empty": (
        lambda seen: Trajectory([], seen.values[:0], ("x",)),
        ShapeError,
        r"one sample and one signal, got .*0, 1",
    ),
    "no samples": (lambda seen: seen.first(0), InputError, "num_samples from 1 to 8, got 0"),
    "half a sample": (lambda seen: seen.first(2.5), InputError, "num_samples from 1 to 8, got 2.5"),
}


@pytest.mark.parametrize("kind", OBSERVED)
def test_observations_that_cannot_be_used(fitted: InteractionPredictor, new: Demonstration, kind: str) -> None:
    change, error, message = OBSERVED[kind]
    with pytest.raises(error, match=message):
        fitted.predict(change(beginning(new)), new.environment)


SCENES = {
    "dict": (lambda: {"width": 1.0, "height": 200.0}, InputError, "environment as EnvironmentFeatures, got dict. Make"),
    "list": (lambda: [1.0, 200.0], InputError, "environment as EnvironmentFeatures, got list"),
    "unknown": (
        lambda: EnvironmentFeatures(("width", "depth"), [1.0, 2.0]),
        InputError,
        r"environment features \('width', 'height'\), got \('width', 'depth'\)",
    ),
    "one of two": (
        lambda: EnvironmentFeatures(("width",), [1.0]),
        InputError,
        "Missing ones are given with observed=False",
    ),
    "not a number": (
        lambda: EnvironmentFeatures(SCENE, [1.0, float("nan")]),
        InputError,
        r"finite numbers in value, got nan at index \(1,\) .* Mark missing features with observed=False",
    ),
    "too many": (
        lambda: EnvironmentFeatures(SCENE, torch.ones(3, 2)),
        ShapeError,
        r"a batch \(3,\) of environments for a batch \(2,\) of motions",
    ),
}


@pytest.mark.parametrize("kind", SCENES)
def test_scenes_that_cannot_be_used(fitted: InteractionPredictor, new: Demonstration, kind: str) -> None:
    make, error, message = SCENES[kind]
    with pytest.raises(error, match=message):
        fitted.predict([beginning(new), beginning(new)], make())


@pytest.mark.parametrize(
    ("time", "error", "message"),
    [
        ([], ShapeError, r"S at least 1, got \(0,\)"),
        (1.0, ShapeError, r"S at least 1, got \(\)"),
        ([0.0, float("nan")], InputError, "finite numbers in time, got nan"),
        ("now", InputError, "time as numbers"),
    ],
)
def test_times_that_cannot_be_asked_for(fitted: InteractionPredictor, new: Demonstration, time, error, message) -> None:
    with pytest.raises(error, match=message):
        fitted.predict(beginning(new), new.environment, time=time)
    with pytest.raises(error, match=message):
        fitted.predict(beginning(new)).at(time)


def test_unknown_blocks_and_numbers_of_draws(fitted: InteractionPredictor, new: Demonstration) -> None:
    def row(block: str, width: int) -> LinearObservation:
        return LinearObservation({block: torch.ones(1, width)}, torch.zeros(1), torch.ones(1), torch.ones(1))

    with pytest.raises(InputError, match=r"blocks among \('human', 'robot', 'environment'\), got \['obstacle'\]"):
        fitted.predict(beginning(new), new.environment, also=[row("obstacle", 2)])
    with pytest.raises(ShapeError, match=r"block 'environment' with 2 columns, got 3"):
        fitted.predict(beginning(new), new.environment, also=[row("environment", 3)])
    with pytest.raises(InputError, match=r"blocks among \('human', 'robot'\), got \['environment'\]"):
        fitted.predict(beginning(new), also=[row("environment", 2)])
    prediction = fitted.predict(beginning(new))
    with pytest.raises(InputError, match="num as an integer of at least 1, got 0"):
        prediction.sample(0, torch.Generator())
    with pytest.raises(InputError, match="num_samples as an integer of at least 1, got 0"):
        prediction.plan(0)


@pytest.mark.parametrize("noise", [-1.0, float("nan"), float("inf"), [0.1, 0.2]])
def test_noise_that_cannot_be_given(fitted: InteractionPredictor, noise) -> None:
    message = "noise as one standard deviation or 1 of them, finite and at least 0"
    with pytest.raises(InputError, match=message):
        fitted.with_noise(noise)
    with pytest.raises(InputError, match=message):
        InteractionPredictor(phase=ElapsedClock(), noise=noise).fit(some(3))


@pytest.mark.parametrize("came", [None, [motion(1.0), motion(2.0)], torch.ones(3, 2)])
def test_fit_takes_a_set(came) -> None:
    with pytest.raises(InputError, match=r"demonstrations as DemonstrationSet, got \w+\. Make one with"):
        quick().fit(came)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Demonstration(np.ones((3, 1))), "human and robot as Trajectory, got ndarray"),
        (lambda: Demonstration(motion(1.0).human, environment=[1.0]), "environment as EnvironmentFeatures, got list"),
        (lambda: DemonstrationSet([motion(1.0).human]), "member number 0 of the set as Demonstration, got Trajectory"),
        (lambda: InteractionPredictor(model="gaussian"), "model as AbstractJointModel, got str"),
        (lambda: InteractionPredictor(phase="dtw"), "phase as AbstractPhaseEstimator, got str"),
        (lambda: InteractionPredictor(features="raw"), "features as AbstractFeatureMap, got str"),
        (lambda: InteractionPredictor(features=[]), "at least one AbstractFeatureMap in features, got none"),
        (lambda: InteractionPredictor(phase=[]), "at least one AbstractPhaseEstimator in phase, got none"),
        (lambda: quick().fit(some(1)), "at least two demonstrations to learn a covariance, got one. Record more"),
        (
            lambda: quick().fit(DemonstrationSet([motion(1.0, samples=1), motion(2.0), motion(3.0)])),
            r"motions with at least two seen samples, got a duration of 0 s for motion \(0,\)",
        ),
    ],
)
def test_parts_of_another_kind(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def is_usable(predictor: InteractionPredictor, new: Demonstration) -> bool:
    results = [predictor.predict(beginning(new, samples), new.environment) for samples in (1, 2, 8)]
    finite = [torch.isfinite(result.mean).all() and torch.isfinite(result.variance).all() for result in results]
    return all(finite) and all(bool((result.variance > 0).all()) for result in results)


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("groups", [None, "one"])
def test_fewer_demonstrations_than_weights(new: Demonstration, count: int, groups: str | None) -> None:
    few = DemonstrationSet(list(some(count)), None if groups is None else [groups] * count)
    reason = "are too few to leave a group out" if groups is None else r"are of one group \('one'\)"
    # Three by themselves leave two to learn from, and reach as far as the new scene.
    with (
        nullcontext() if (count, groups) == (3, None) else pytest.warns(HeldOutWarning, match=f"All {count} .*{reason}")
    ):
        fitted = quick().fit(few)
    with nullcontext() if count == 3 else pytest.warns(ExtrapolationWarning, match="width = 1.75 lies far outside"):
        assert is_usable(fitted, new)


@pytest.mark.parametrize("amount", [0.0, 1.5])  # 0: every signal is constant
def test_duplicates_are_predicted_as_they_are(amount: float) -> None:
    one = motion(amount)
    fitted = quick().fit(DemonstrationSet([one] * 5))
    assert is_usable(fitted, one)
    assert one.human is not None and one.robot is not None
    came = fitted.predict(one.human.first(8), one.environment, time=one.robot.time)
    torch.testing.assert_close(came.mean, one.robot.values, rtol=0.0, atol=2e-3)


def test_one_sample_says_less_than_eight(fitted: InteractionPredictor, new: Demonstration) -> None:
    one, eight = (fitted.predict(beginning(new, samples)).variance.mean() for samples in (1, 8))
    assert eight < 0.5 * one


def test_order_of_features_among_demonstrations_and_through_a_file(
    fitted: InteractionPredictor, new: Demonstration, tmp_path: Path
) -> None:
    mixed = [
        Demonstration(one.human, one.robot, one.environment.ordered_as(SCENE[:: 1 - 2 * (i % 2)]))
        for i, one in enumerate(some())
        if one.environment is not None
    ]
    loaded = DemonstrationSet.load(DemonstrationSet(mixed, some().groups).save(tmp_path / "set.npz"))
    assert new.environment is not None
    other = quick().fit(loaded).predict(beginning(new), new.environment.ordered_as(SCENE[::-1]))
    torch.testing.assert_close(other.mean, fitted.predict(beginning(new), new.environment).mean, rtol=1e-12, atol=0)


def test_sets_are_not_saved_over_folders(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    for path in (tmp_path, tmp_path / "file" / "set.npz", tmp_path / "file" / "a" / "set.npz"):
        with pytest.raises(InputError, match="the path of a file in a folder"):
            some(2).save(path)
    assert os.listdir(tmp_path) == ["file"] and (tmp_path / "file").read_text() == "kept"


def test_files_that_cannot_be_read_are_left_as_they_are(tmp_path: Path) -> None:
    whole = some(2).save(tmp_path / "set.npz").read_bytes()
    pickled = tmp_path / "pickled.npz"
    np.savez(pickled, header=np.array([{"a": 1}], dtype=object))
    for name, content, message in (
        ("half.npz", whole[: len(whole) // 2], "damaged, truncated or of another kind .* Copy or make it again"),
        ("flipped.npz", whole.replace(b"strict", b"loosen")[:-40] + whole[-39:], "damaged, truncated"),
        ("pickled.npz", pickled.read_bytes(), "Pickled objects are never loaded"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(DataFileError, match=message):
            DemonstrationSet.load(path)
        assert path.read_bytes() == content
    with pytest.raises(MissingDataError, match="no such file"):
        DemonstrationSet.load(tmp_path / "none.npz")


@functools.cache
def script(name: str) -> Experiment:
    spec = importlib.util.spec_from_file_location(f"bad_input_{name}", ROOT / "experiments" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.run


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("num_train=0", "at least one motion for a rectangle, got 0"),
        ("num_train=many", "num_train as an integer, such as 10, got 'many'"),
        ("num_train=2.5", "num_train as an integer, such as 10, got 2.5"),
        ("seed=true", "seed as an integer, such as 0, got True"),
        ("seed=-1", "a seed of at least zero, got -1"),
        ("threads=0", "threads as an integer of at least 1, got 0"),
        ("samples_seen=[0]", "samples_seen as integers from 1 to 1.., .* got .0"),
        ("samples_seen=[10,5000]", "leaves every test motion a future, got .5000"),
        ("samples_seen=[]", "samples_seen as a list of numbers, such as .10, 20, .* got .."),
        ("samples_seen=10", "samples_seen as a list of numbers, .* got 10"),
        ("+predictor.model.covariance.amount=2", "amount between 0 and 1, got 2"),
        ("predictor.human._target_=eaip_prob.primitives.Spline", "'predictor.human' .*Spline.* Mend its _target_"),
        ("evidence=forcing", "a DMP for forcing evidence, got ProMP. Use evidence=position"),
        ("predictor.target=robot", "predict it with target='human'"),
        ("predictor.model.environment=none", "environment"),
        ("task.rate=0", "rate above zero"),
    ],
)
def test_a_refused_run_leaves_its_folder_free(tmp_path: Path, override: str, message: str) -> None:
    run = script("passing_over")
    with pytest.raises(InputError, match=message):
        run.execute(run.compose([*SMALL, override]), tmp_path)
    assert set(os.listdir(tmp_path)) <= REFUSED
    assert not RunFolder(tmp_path).is_finished("another configuration")


def test_kinds_follow_the_defaults() -> None:
    defaults = {"count": 3, "size": 1.5, "flag": True, "lengths": [1], "name": "a", "part": {"count": 1}}
    check_kinds({"count": 4, "size": 2, "flag": 1, "lengths": [0.5, 2], "name": 3, "part": {"count": "x"}}, defaults)
    for wrong in ({"count": 4.0}, {"count": True}, {"size": "x"}, {"lengths": ["1"]}, {"lengths": "12"}):
        with pytest.raises(InputError, match=f"Expected {next(iter(wrong))} as "):
            check_kinds(wrong, defaults)


def broken(fails: BaseException | None) -> Experiment:
    @experiment("base")
    def run(cfg, folder):
        (folder / "figure.txt").write_text("drawn")
        if fails is not None:
            raise fails
        return {"rmse": 0.5}

    return run


@pytest.mark.parametrize("fails", [KeyboardInterrupt(), InputError("late"), RuntimeError("bug")])
def test_a_run_that_was_stopped_keeps_what_it_drew_and_can_go_on(tmp_path: Path, fails: BaseException) -> None:
    run = broken(fails)
    with pytest.raises(type(fails)):
        run.execute(run.compose(), tmp_path)
    said = ["error.txt"] if isinstance(fails, Exception) else []
    assert sorted(os.listdir(tmp_path)) == ["config.yaml", "environment.json", *said, "figure.txt"]
    with pytest.raises(InputError, match="another configuration.*nothing was overwritten"):
        run.execute(run.compose(["seed=1"]), tmp_path)
    assert broken(None).execute(run.compose(), tmp_path) == {"rmse": 0.5}
    assert not (tmp_path / "error.txt").exists()


@pytest.mark.parametrize("failing", ["replace", "dumps"])
def test_metrics_are_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str) -> None:
    run = broken(None)
    real = {"replace": os.replace, "dumps": json.dumps}[failing]

    def fail(*arguments, **options):
        if "metrics.json" in str(arguments[-1]) or arguments[0] == {"rmse": 0.5}:
            raise OSError(errno.ENOSPC, "disk full")
        return real(*arguments, **options)

    with monkeypatch.context() as patched:
        patched.setattr(os if failing == "replace" else json, failing, fail)
        with pytest.raises(StorageError, match="room for results in .*, got: disk full. Make room"):
            run.execute(run.compose(), tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["config.yaml", "environment.json", "error.txt", "figure.txt"]
    assert run.execute(run.compose(), tmp_path) == {"rmse": 0.5}
    assert json.loads((tmp_path / "metrics.json").read_text()) == {"rmse": 0.5}


def start(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "experiments" / f"{name}.py"), *arguments]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nope=3"], "Could not override 'nope'. To append to your config use +nope=3"),
        (
            ["phase=none_such"],
            "Available options in 'phase': absolute chosen dtw elapsed expected expected_marginal "
            "expected_marginal_wide known marginal",
        ),
        (["samples_seen=[10"], "no viable alternative at input '[10'"),
        (["num_train=0"], "Expected at least one motion for a rectangle, got 0."),
        (["phase=known"], "Expected the true durations for the known phase."),
    ],
)
def test_a_command_line_is_refused_in_one_sentence(tmp_path: Path, arguments: list[str], message: str) -> None:
    done = start("passing_over", f"run_dir={tmp_path / 'run'}", *SMALL, *arguments)
    lines = [line for line in done.stderr.splitlines() if "s/it" not in line and "it/s" not in line]
    assert done.returncode == 2 and len(lines) == 1, done.stderr[-2000:]
    assert message in lines[0] and "Traceback" not in done.stdout
    assert not (tmp_path / "run").exists() or set(os.listdir(tmp_path / "run")) <= REFUSED


@pytest.mark.slow
@pytest.mark.parametrize("name", ["passing_over", "handover", "reach_to_grasp"])
def test_a_file_is_no_run_folder(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("kept")
    for place in ("file", "file/inside"):
        done = start(name, f"run_dir={tmp_path / place}")
        assert done.returncode == 2 and done.stderr.startswith("Expected run_dir as a folder, or a new one, got: ")
        assert done.stderr.count("\n") == 1
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.slow
def test_absent_data_can_be_put_there_later(tmp_path: Path) -> None:
    run = f"run_dir={tmp_path / 'run'}"
    done = start("handover", run, f"data_dir={tmp_path}")
    assert done.returncode == 0 and done.stdout.count("\n") == 1 and "set data_dir to the folder" in done.stdout
    assert set(os.listdir(tmp_path / "run")) == REFUSED


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "error"),
    [
        (["phase=marginal", "covariance@predictor.model.covariance=empirical"], "rmse"),
        # From ten samples and three demonstrations DTW misses the tempo; the shape it promises is still better.
        (["phase=dtw", "robot=promp"], "dtw"),
        (["phase=elapsed", "human=dmp", "evidence=forcing"], "rmse"),
    ],
)
def test_first_steps_on_the_command_line_run(tmp_path: Path, overrides: list[str], error: str) -> None:
    run = script("passing_over")
    metrics = run.execute(run.compose([*SMALL, *overrides]), tmp_path)
    assert metrics is not None and metrics[f"{error}/both/eaip/10"] < metrics[f"{error}/both/mean/10"]
