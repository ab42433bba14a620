from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError
from eaip_prob.tasks.passing_over import CursorPerson, PassingOver

SIZES = [(width, height) for width in (125.0, 215.0, 325.0) for height in (125.0, 215.0, 325.0)]


def task_of(**tempo: float) -> PassingOver:
    return PassingOver(person=CursorPerson(**tempo))


# Written down before there was any other tempo.
@pytest.mark.parametrize(
    ("seed", "size", "counts", "numbers"),
    [
        (0, (215.0, 125.0), [174, 189, 229], (58736.83685613428, -254.26715026458925, 137.49594040435932)),
        (7, (325.0, 325.0), [175, 185], (74754.9012627468, -369.1712431457618, 377.68716775017305)),
        (3, (50.0, 400.0), [181], (41526.208800820415, -288.9308760178445, 417.39539004224395)),
    ],
)
def test_the_default_person_moves_as_ever(seed, size, counts, numbers):
    motions = PassingOver().motions(*size, len(counts), torch.Generator().manual_seed(seed))
    assert motions.seen.sum(-1).tolist() == counts
    found = motions.values.sum(), motions.values[0, 37, 0], motions.values[-1, 90, 1]
    assert [float(number) for number in found] == pytest.approx(numbers, rel=1e-11, abs=0)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("spread", [0.1, 0.4])
def test_log_durations_vary_as_asked_and_as_much_by_the_rectangle(spread, share):
    num = 20_000
    person = CursorPerson(tempo_sd=spread, tempo_dependence=share, duration=(1.0, 2.0))
    individual = person.intend(num, 100.0, torch.Generator().manual_seed(2)).duration.log()
    stretches = torch.tensor([person.stretch(*size) for size in SIZES], dtype=torch.float64).log()
    assert abs(float(individual.mean()) - math.log(1.5)) <= 4 * spread * ((1.0 - share) / num) ** 0.5 + 1e-12
    assert float(stretches.mean()) == pytest.approx(0.0, abs=1e-12)
    assert float(stretches.var(correction=0)) == pytest.approx(share * spread**2, rel=1e-9)
    total = float((individual + stretches[:, None]).std(correction=0))
    assert total == pytest.approx(spread, rel=4 / (2 * num) ** 0.5)


def test_a_longer_way_takes_longer_in_proportion_to_its_log():
    person = CursorPerson(tempo_sd=0.3, tempo_dependence=1.0)
    way = np.array(
        [math.hypot(350 - w / 2, h - 30) * 2 + w for w, h in SIZES]  # over both upper corners
    )
    logs = np.log(way)
    expected = np.exp(0.3 * (logs - logs.mean()) / logs.std())
    assert [person.stretch(*size) for size in SIZES] == pytest.approx(list(expected), rel=1e-12)
    assert person.stretch(400.0, 400.0) > max(expected) and person.stretch(50.0, 50.0) < min(expected)


def test_without_dependence_the_rectangle_has_no_say():
    for task in (PassingOver(), task_of(tempo_sd=0.3)):
        one, other = (task.person.intend(50, 100.0, torch.Generator().manual_seed(3)) for _ in range(2))
        assert torch.equal(one.duration, other.duration)
        durations = [
            task.motions(*size, 50, torch.Generator().manual_seed(3)).duration.tolist()
            for size in (SIZES[0], SIZES[-1])
        ]
        assert durations[0] == durations[1]


def test_start_and_end_are_independent_of_the_tempo():
    intended = [
        CursorPerson(**tempo).intend(40, 100.0, torch.Generator().manual_seed(5))
        for tempo in ({}, {"tempo_sd": 0.4}, {"tempo_sd": 0.4, "tempo_dependence": 0.9})
    ]
    for other in intended[1:]:
        assert torch.equal(intended[0].start, other.start) and torch.equal(intended[0].end, other.end)


def test_a_failed_motion_keeps_its_own_tempo():
    person = CursorPerson(direction_sd=1.0, tremor=0.0, tempo_sd=0.3, tempo_dependence=0.5)
    careless = PassingOver(person=person)
    intended = person.intend(200, 100.0, torch.Generator().manual_seed(3))
    motions = careless.motions(325.0, 325.0, 200, torch.Generator().manual_seed(3))
    expected = intended.duration * person.stretch(325.0, 325.0)
    torch.testing.assert_close(motions.duration, expected, rtol=0.0, atol=0.005 + 1e-9)
    torch.testing.assert_close(motions.values[:, 0], intended.start)


@pytest.mark.parametrize("rate", [25.0, 100.0])
def test_no_spread_is_one_duration(rate):
    for share in (0.0, 0.9):
        task = dataclasses.replace(task_of(tempo_sd=0.0, tempo_dependence=share), rate=rate)
        motions = task.motions(325.0, 125.0, 20, torch.Generator().manual_seed(0))
        torch.testing.assert_close(motions.duration, torch.full((20,), 2.0, dtype=torch.float64))


@pytest.mark.parametrize(
    ("tempo", "message"),
    [
        ({"tempo_sd": -0.1}, "tempo_sd of at least zero"),
        ({"tempo_sd": math.nan}, "tempo_sd of at least zero"),
        ({"tempo_sd": 0.1, "tempo_dependence": 1.1}, "tempo_dependence between 0 and 1"),
        ({"tempo_dependence": 0.5}, "tempo_sd with tempo_dependence"),
    ],
)
def test_bad_tempo_is_refused(tempo, message):
    with pytest.raises(InputError, match=message):
        CursorPerson(**tempo)
