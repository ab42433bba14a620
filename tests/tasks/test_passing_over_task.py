from __future__ import annotations

import dataclasses
from itertools import product
from pathlib import Path

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from eaip_prob.errors import InputError
from eaip_prob.tasks.passing_over import CursorPerson, PassingOver, clearance, passed, rise

CONF = Path(__file__).parents[2] / "conf" / "task" / "passing_over.yaml"
QUIET = CursorPerson(
    start_sd=(0.0, 0.0), end_sd=(0.0, 0.0), clearance_sd=0.0, corner_sd=0.0, direction_sd=0.0, share_sd=0.0, tremor=0.0
)


@pytest.fixture(scope="module")
def task() -> PassingOver:
    return instantiate(OmegaConf.load(CONF))


def _generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_rectangles_of_the_paper(task: PassingOver) -> None:
    assert sorted(task.sizes) == sorted(product((125.0, 215.0, 325.0), repeat=2))
    assert sorted(task.novel_sizes) == sorted(product((50.0, 400.0), repeat=2))


def test_demonstrations_of_all_rectangles(task: PassingOver) -> None:
    demonstrations = task.demonstrations(3, seed=0)
    assert len(demonstrations) == 27 and demonstrations.agents == ("human",)
    assert demonstrations.groups[3:6] == ("125x215",) * 3
    motion = demonstrations[3]
    assert motion.human is not None and motion.human.names == ("x", "y") and bool(motion.human.mask.all())
    assert motion.environment is not None and motion.environment.names == ("width", "height")
    assert motion.environment.value.tolist() == [125.0, 215.0] and float(motion.environment.covariance.abs().sum()) == 0
    torch.testing.assert_close(motion.human.time.diff(), torch.full_like(motion.human.time[1:], 0.01))


@pytest.mark.parametrize("part", ["train", "test", "novel"])
def test_demonstrations_succeed_with_margin(task: PassingOver, part: str) -> None:
    demonstrations = task.demonstrations(10, seed=5, part=part)
    human, environments = demonstrations.trajectories("human"), demonstrations.environments
    assert environments is not None
    width, height = environments.value.unbind(-1)
    assert bool(passed(human.values, width, height, task.bound, human.seen).all())
    assert float(rise(human.values, height, human.seen).max()) < task.bound - 15.0
    assert 15.0 < float(clearance(human.values, width, height, human.seen).median()) < task.person.clearance + 5.0


def test_sample_counts(task: PassingOver) -> None:
    motions = task.motions(215.0, 325.0, 2000, _generator(1))
    counts = motions.seen.sum(-1).double()
    assert counts.min() == 170 and counts.max() == 230
    deviation = ((61**2 - 1) / 12) ** 0.5
    assert abs(float(counts.mean()) - 200.0) < 4 * deviation / 2000**0.5
    torch.testing.assert_close(motions.duration, (counts - 1) / 100.0)


def test_rate_changes_samples_and_not_seconds(task: PassingOver) -> None:
    slow = dataclasses.replace(task, rate=25.0, person=dataclasses.replace(QUIET, duration=(2.0, 2.0)))
    fast = dataclasses.replace(slow, rate=100.0)
    few, many = (each.motions(215.0, 125.0, 1, _generator(0)) for each in (slow, fast))
    assert (few.num_samples, many.num_samples) == (50, 200)
    share = torch.linspace(0.0, 1.0, 7, dtype=torch.float64)
    for at in share:
        low, high = (float(at) * (each.num_samples - 1) for each in (few, many))
        if low.is_integer() and high.is_integer():
            torch.testing.assert_close(few.values[0, int(low)], many.values[0, int(high)])


def test_start_and_tempo_do_not_know_the_rectangle(task: PassingOver) -> None:
    num = 2000
    small, large = (task.motions(w, h, num, _generator(s)) for w, h, s in ((125.0, 125.0, 1), (325.0, 325.0, 2)))
    for measure in (
        lambda motions: motions.values[:, 0, 0],
        lambda motions: motions.values[:, 0, 1],
        lambda motions: motions.duration,
    ):
        one, other = measure(small), measure(large)
        error = ((one.var() + other.var()) / num).sqrt()
        assert abs(float(one.mean() - other.mean())) < 4 * error
        assert abs(float((one.std() / other.std()).log())) < 4 * num**-0.5


def test_start_and_tempo_survive_replanning(task: PassingOver) -> None:
    # A careless person's via-points lie in any direction from the corners, inside the rectangle too.
    careless = dataclasses.replace(task, person=CursorPerson(direction_sd=1.0, tremor=0.0))
    intended = careless.person.intend(300, 100.0, _generator(3))
    first = careless.person.move(intended, 215.0, 325.0, 100.0, _generator(4))
    assert 5 < int((~passed(first.values, 215.0, 325.0, task.bound, first.seen)).sum()) < 295
    for width, height in ((125.0, 125.0), (215.0, 325.0)):
        motions = careless.motions(width, height, 300, _generator(3))
        assert bool(passed(motions.values, width, height, task.bound, motions.seen).all())
        torch.testing.assert_close(motions.values[:, 0], intended.start)
        counts = (intended.duration * 100.0).round().long() + 1
        assert motions.seen.sum(-1).tolist() == counts.tolist()
        last = motions.values[torch.arange(300), counts - 1]
        torch.testing.assert_close(last, intended.end)


def test_plan_without_variation_is_symmetric_and_rests(task: PassingOver) -> None:
    quiet = dataclasses.replace(task, person=dataclasses.replace(QUIET, duration=(2.0, 2.0)))
    path = quiet.motions(215.0, 125.0, 1, _generator(0)).values[0]
    torch.testing.assert_close(path.flip(0) * torch.tensor([-1.0, 1.0]), path)
    torch.testing.assert_close(path[[0, -1]], torch.tensor([[-350.0, 30.0], [350.0, 30.0]], dtype=torch.float64))
    # At rest the first step grows with the cube of time, so at eight times the step the way is 512 steps.
    assert path[1].sub(path[0]).norm() < 0.005 and path[8].sub(path[0]).norm() < 2.5
    corner = torch.tensor([-107.5, 125.0]) + task.person.clearance / 2**0.5 * torch.tensor([-1.0, 1.0])
    assert float((path - corner).norm(dim=-1).min()) < 5.0


def test_variation_of_a_person() -> None:
    num, person = 4000, CursorPerson()
    intention = person.intend(num, 100.0, _generator(0))
    for values, mean, spread in (
        (intention.start, person.start, person.start_sd),
        (intention.end, person.end, person.end_sd),
    ):
        error = torch.tensor(spread) / num**0.5
        assert bool(((values.mean(0) - torch.tensor(mean)).abs() < 4 * error).all())
        assert bool(((values.std(0) - torch.tensor(spread)).abs() < 4 * error / 2**0.5).all())
    left, right = person._via_points(num, 200.0, 100.0, _generator(1))
    outward = torch.stack([-100.0 - left[:, 0], right[:, 0] - 100.0], -1)
    upward = torch.stack([left[:, 1], right[:, 1]], -1) - 100.0
    distance = torch.hypot(outward, upward).log()
    total = (person.clearance_sd**2 + person.corner_sd**2) ** 0.5
    assert abs(float(distance.mean() - torch.tensor(person.clearance).log())) < 4 * total / num**0.5
    assert bool(((distance.std(0) - total).abs() < 4 * total / (2 * num) ** 0.5).all())
    shared = person.clearance_sd**2 / total**2
    correlation = float(torch.corrcoef(distance.T)[0, 1])
    assert abs(correlation - shared) < 4 * (1 - shared**2) / num**0.5
    direction = torch.atan2(upward, outward)
    assert abs(float(direction.mean()) - torch.pi / 4) < 4 * person.direction_sd / (2 * num) ** 0.5
    assert abs(float(direction.std()) - person.direction_sd) < 4 * person.direction_sd / (4 * num) ** 0.5


def test_segment_durations() -> None:
    num, person = 4000, CursorPerson()
    points = torch.tensor([[0.0, 0.0], [0.0, 300.0], [160.0, 300.0], [160.0, 200.0]], dtype=torch.float64)
    total = torch.linspace(1.7, 2.3, num, dtype=torch.float64)
    durations = person._segment_durations(points.expand(num, 4, 2), total, _generator(0))
    torch.testing.assert_close(durations.sum(-1), total)
    ratio = (durations[:, 0] / durations[:, 1]).log()
    spread = 2**0.5 * person.share_sd
    assert abs(float(ratio.mean()) - float(torch.tensor(2.0 * (300 / 160) ** 0.8).log())) < 4 * spread / num**0.5
    assert abs(float(ratio.std()) - spread) < 4 * spread / (2 * num) ** 0.5


def test_tremor_is_on_top_of_the_plan(task: PassingOver) -> None:
    person = dataclasses.replace(QUIET, tremor=0.7, duration=(2.0, 2.0))
    shaking, calm = (
        dataclasses.replace(task, person=each) for each in (person, dataclasses.replace(person, tremor=0.0))
    )
    difference = (
        shaking.motions(215.0, 125.0, 300, _generator(0)).values - calm.motions(215.0, 125.0, 1, _generator(0)).values
    )
    error = 0.49 * (2.0 / (300 * 32)) ** 0.5
    assert abs(float(difference.square().mean()) - 0.49) < 4 * error


def test_seeds_and_parts_have_streams_of_their_own(task: PassingOver) -> None:
    starts = [
        demonstration.human.values[0].tolist()
        for seed, part in product((0, 1), ("train", "test", "novel"))
        for demonstration in task.demonstrations(2, seed, part)
        if demonstration.human is not None
    ]
    assert len({tuple(start) for start in starts}) == len(starts) == 2 * (18 + 18 + 8)


def test_a_seed_fixes_everything(task: PassingOver) -> None:
    one, other = (task.demonstrations(2, seed=7).trajectories("human") for _ in range(2))
    assert torch.equal(one.values, other.values) and torch.equal(one.mask, other.mask)
    motions = [task.motions(400.0, 50.0, 4, _generator(9)).values for _ in range(2)]
    assert torch.equal(*motions)


def test_bad_input_is_refused(task: PassingOver) -> None:
    with pytest.raises(InputError, match="Expected width above zero and finite, got -125"):
        PassingOver(sizes=[(-125.0, 125.0)], novel_sizes=[], bound=160.0)
    with pytest.raises(InputError, match="Expected height above zero and finite, got 0"):
        task.motions(125.0, 0.0, 1, _generator(0))
    with pytest.raises(InputError, match="Expected a width below 460 px.* got 700"):
        task.motions(700.0, 50.0, 1, _generator(0))
    with pytest.raises(InputError, match="Expected a width below 460 px"):
        dataclasses.replace(task.person, start=(-400.0, 30.0)).check_fits(470.0, 50.0)
    with pytest.raises(InputError, match="at least one motion for a rectangle, got 0"):
        task.demonstrations(0, seed=0)
    with pytest.raises(InputError, match="seed of at least zero, got -1"):
        task.demonstrations(1, seed=-1)
    with pytest.raises(InputError, match=r"part to be one of \('train', 'test', 'novel'\), got 'validation'"):
        task.demonstrations(1, seed=0, part="validation")
    with pytest.raises(InputError, match="different pairs"):
        PassingOver(sizes=[(125.0, 125.0), (125.0, 125.0)], novel_sizes=[], bound=160.0)
    with pytest.raises(InputError, match="succeed within 50 attempts"):
        dataclasses.replace(task, bound=1.0).motions(325.0, 325.0, 2, _generator(0))


def test_bad_person_is_refused() -> None:
    with pytest.raises(InputError, match=r"negative one in \['share_sd', 'start_sd'\]"):
        CursorPerson(share_sd=-0.1, start_sd=(1.0, -1.0))
    with pytest.raises(InputError, match="Expected clearance above zero"):
        CursorPerson(clearance=0.0)
    with pytest.raises(InputError, match="shortest, longest"):
        CursorPerson(duration=(2.0, 1.0))
