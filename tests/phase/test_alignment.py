from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.phase.alignment import OpenEnd, dtw_cost, medoid, open_end, open_end_batch


def walk(seed, *shape):
    generator = torch.Generator().manual_seed(seed)
    return 300.0 + 7.0 * torch.randn(*shape, generator=generator, dtype=torch.float64).cumsum(-2)


def hidden(seed, *shape, share=0.3):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed)) > share


def slow_table(query, reference, mask=None):
    mask = torch.ones_like(query, dtype=torch.bool) if mask is None else mask
    table = [[math.inf] * (len(reference) + 1) for _ in range(len(query) + 1)]
    table[0][0] = 0.0
    for i, (sample, seen) in enumerate(zip(query.tolist(), mask.tolist(), strict=True)):
        for j, other in enumerate(reference.tolist()):
            d = math.sqrt(sum((a - b) ** 2 for a, b, s in zip(sample, other, seen, strict=True) if s))
            table[i + 1][j + 1] = d + min(table[i][j + 1], table[i + 1][j], table[i][j])
    return torch.tensor([row[1:] for row in table[1:]], dtype=torch.float64)


def slow_open_end(query, reference, mask=None):
    rows = slow_table(query, reference, mask).tolist()
    return [row.index(min(row)) for row in rows], torch.tensor([min(row) for row in rows], dtype=torch.float64)


@pytest.mark.parametrize(("num_query", "num_reference", "num_signals"), [(1, 1, 1), (13, 29, 2), (31, 7, 6), (5, 1, 3)])
@pytest.mark.parametrize("masked", [False, True])
def test_open_end_equals_slow_loop(num_query, num_reference, num_signals, masked):
    query, reference = walk(1, num_query, num_signals), walk(2, num_reference, num_signals)
    mask = hidden(3, num_query, num_signals) if masked else None
    end_index, cost = open_end(query, reference, mask)
    expected_index, expected_cost = slow_open_end(query, reference, mask)
    assert end_index.tolist() == expected_index
    torch.testing.assert_close(cost, expected_cost, rtol=1e-12, atol=1e-12)


def test_open_end_of_a_prefix_is_exact():
    reference = walk(4, 50, 3)
    end_index, cost = open_end(reference[:20], reference)
    assert end_index.tolist() == list(range(20))
    assert cost.tolist() == [0.0] * 20


def test_open_end_follows_a_slower_motion():
    reference = walk(40, 61, 2)
    assert open_end(reference.repeat_interleave(3, 0), reference)[0].tolist() == [i // 3 for i in range(183)]


def test_open_end_ties_go_to_the_first():
    reference = torch.tensor([[0.0], [1.0], [1.0], [1.0]], dtype=torch.float64)
    assert open_end(reference[:2], reference)[0].tolist() == [0, 1]


def test_open_end_cost_never_falls_with_another_sample():
    cost = open_end(walk(5, 4, 40, 2), walk(6, 30, 2), hidden(7, 4, 40, 2))[1]
    assert bool((cost.diff(dim=-1) >= 0).all())


@pytest.mark.parametrize("junk", [0.0, 1e6, math.nan, math.inf])
def test_hidden_values_are_never_read(junk):
    query, reference, mask = walk(8, 25, 3), walk(9, 20, 3), hidden(10, 25, 3)
    expected = open_end(query, reference, mask)
    came = open_end(torch.where(mask, query, junk), reference, mask)
    assert torch.equal(expected[0], came[0])
    assert torch.equal(expected[1], came[1])


def test_signal_always_hidden_equals_no_such_signal():
    query, reference = walk(11, 25, 3), walk(12, 20, 3)
    mask = torch.tensor([True, False, True]).expand(25, 3)
    expected = open_end(query[:, [0, 2]], reference[:, [0, 2]])
    came = open_end(query, reference, mask)
    assert torch.equal(expected[0], came[0])
    torch.testing.assert_close(expected[1], came[1], rtol=1e-13, atol=0.0)


def test_sample_without_a_signal_costs_nothing_and_moves_nothing():
    query, reference, mask = walk(13, 12, 2), walk(14, 20, 2), torch.ones(12, 2, dtype=torch.bool)
    mask[5:8] = False
    end_index, cost = open_end(query, reference, mask)
    assert end_index[4:8].unique().numel() == 1
    assert cost[4:8].unique().numel() == 1


@pytest.mark.parametrize("batch", [(), (2, 3)])
def test_batch_equals_loop(batch):
    query, reference, mask = walk(15, *batch, 17, 2), walk(16, 23, 2), hidden(17, *batch, 17, 2)
    before = query.clone()
    end_index, cost = open_end(query, reference, mask)
    assert end_index.shape == cost.shape == (*batch, 17)
    assert torch.equal(open_end_batch(query, reference, mask), end_index)
    assert torch.equal(query, before)
    for index in np.ndindex(*batch):
        single = open_end(query[index], reference, mask[index])
        assert torch.equal(single[0], end_index[index])
        assert torch.equal(single[1], cost[index])


def test_lengths_of_padded_queries():
    query, reference, lengths = walk(18, 4, 15, 2), walk(19, 15, 2), torch.tensor([15, 1, 9, 4])
    query[2, 9:] = math.nan
    came = open_end_batch(query, reference, lengths=lengths)
    for row, one, length in zip(came, query, lengths.tolist(), strict=True):
        assert torch.equal(row[:length], open_end(one[:length], reference)[0])
        assert bool((row[length:] == row[length - 1]).all())


@settings(max_examples=40, deadline=None)
@given(
    num_query=st.integers(1, 30),
    num_reference=st.integers(1, 40),
    num_signals=st.integers(1, 4),
    seed=st.integers(0, 10**6),
)
def test_steps_equal_batch(num_query, num_reference, num_signals, seed):
    query, reference = walk(seed, num_query, num_signals), walk(seed + 1, num_reference, num_signals)
    mask = hidden(seed, num_query, num_signals)
    expected_index, expected_cost = open_end(query, reference, mask)
    alignment = OpenEnd.start(reference)
    state = alignment.initial
    for i in range(num_query):
        end_index, cost, state = alignment.step(query[i].numpy(), mask[i].numpy(), state)
        assert (end_index, cost) == (int(expected_index[i]), float(expected_cost[i]))


@pytest.mark.parametrize("num_signals", [1, 2])
def test_step_is_functional(num_signals):
    reference, samples = walk(20, 12, num_signals), walk(21, 3, num_signals).numpy()
    seen = np.ones(num_signals, dtype=bool)
    alignment = OpenEnd.start(reference)
    reference += 1.0
    _, _, state = alignment.step(samples[0], seen, alignment.initial)
    kept = state.copy()
    first = alignment.step(samples[1], seen, state)
    alignment.step(samples[2], seen, state)
    again = alignment.step(samples[1], seen, kept)
    assert first[:2] == again[:2]
    assert np.array_equal(first[2], again[2])
    assert np.array_equal(state, kept)
    assert kept.flags.writeable
    assert alignment.step(samples[0], seen, alignment.initial)[1] == float(
        open_end(samples[:1], walk(20, 12, num_signals))[1]
    )
    with pytest.raises(ValueError, match="read-only"):
        state[0] = 1.0


@pytest.mark.parametrize(
    ("sample", "mask", "error", "message"),
    [
        ([1.0], [True], ShapeError, r"shape \(2,\)"),
        ([1.0, 2.0], [True], ShapeError, r"shape \(2,\)"),
        ([1.0, math.nan], [True, True], InputError, "mask=False"),
        ([1.0, math.inf], [True, True], InputError, "mask=False"),
        ([1.0, 2.0], [1, 1], InputError, "booleans"),
    ],
)
def test_step_refuses(sample, mask, error, message):
    alignment = OpenEnd.start(walk(22, 9, 2))
    with pytest.raises(error, match=message):
        alignment.step(np.array(sample), np.array(mask), alignment.initial)
    with pytest.raises(ShapeError, match=r"OpenEnd\.start"):
        alignment.step(np.zeros(2), np.ones(2, dtype=bool), np.zeros(8))


@pytest.mark.parametrize("num_signals", [1, 2, 3, 6])
@pytest.mark.parametrize(("num_plans", "num_references"), [(1, 3), (3, 5), (9, 2)])
def test_closed_cost_equals_slow_loop(num_signals, num_plans, num_references):
    plans, references = walk(23, num_plans, 11, num_signals), walk(24, num_references, 14, num_signals)
    lengths = torch.tensor([14, 1, 6, 13, 14])[:num_references]
    for reference, length in zip(references, lengths.tolist(), strict=True):
        reference[length:] = math.nan
    came = dtw_cost(plans, references, lengths)
    expected = [
        [slow_table(p, r[:n])[-1, -1] for r, n in zip(references, lengths.tolist(), strict=True)] for p in plans
    ]
    torch.testing.assert_close(came, torch.tensor(expected, dtype=torch.float64), rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("num_samples", [(40, 9), (9, 40), (1, 5), (1, 1)])
def test_closed_cost_with_other_lengths(num_samples):
    plan, reference = walk(25, num_samples[0], 2), walk(26, num_samples[1], 2)
    assert float(dtw_cost(plan, reference[None])) == pytest.approx(
        float(slow_table(plan, reference)[-1, -1]), rel=1e-12
    )
    assert torch.equal(dtw_cost(plan, reference[None]), dtw_cost(reference, plan[None]))


def test_closed_cost_shape_and_threads():
    plans, references = walk(27, 2, 3, 30, 2), walk(28, 7, 25, 2)
    before = plans.clone()
    cost = dtw_cost(plans, references)
    assert cost.shape == (2, 3, 7)
    assert torch.equal(cost[1, 2], dtw_cost(plans[1, 2], references))
    assert torch.equal(plans, before)
    for num_threads in (2, 3, 11):
        assert torch.equal(cost, dtw_cost(plans, references, num_threads=num_threads))
    assert dtw_cost(plans[:0], references).shape == (0, 3, 7)


def test_closed_cost_laws():
    paths = walk(29, 6, 20, 2)
    cost = dtw_cost(paths, paths)
    lockstep = (paths[:, None] - paths).norm(dim=-1).sum(-1)
    assert torch.equal(cost, cost.T)
    assert bool((cost.diagonal() == 0.0).all())
    assert bool((cost <= lockstep * (1 + 1e-12)).all())
    assert bool((cost[~torch.eye(6, dtype=torch.bool)] > 0).all())
    torch.testing.assert_close(dtw_cost(-0.01 * paths, -0.01 * paths), 0.01 * cost, rtol=1e-12, atol=0.0)
    ends = (paths[:, None, [0, -1]] - paths[:, [0, -1]]).norm(dim=-1).sum(-1)
    assert bool((cost >= ends * (1 - 1e-12)).all())


def test_pauses_against_itself_cost_nothing():
    path = walk(30, 20, 2)
    paused = path.repeat_interleave(torch.tensor([1, 4, 1, 2] * 5), dim=0)
    assert float(dtw_cost(paused, path[None])) == 0.0


def test_medoid():
    paths = walk(31, 7, 18, 2)
    lengths = torch.tensor([18, 9, 18, 14, 11, 5, 17])
    for path, length in zip(paths, lengths.tolist(), strict=True):
        path[length:] = math.nan
    cut = [path[:length] for path, length in zip(paths, lengths.tolist(), strict=True)]
    total = [sum(float(slow_table(a, b)[-1, -1]) for b in cut) for a in cut]
    assert medoid(paths, lengths) == total.index(min(total))
    assert medoid(paths[1:2], lengths[1:2]) == 0
    offsets = torch.tensor([5.0, 0.0, 1.0, 9.0, 2.0], dtype=torch.float64)
    assert medoid(offsets[:, None, None] + walk(32, 12, 3)) == 4
    assert medoid(torch.zeros(3, 4, 1, dtype=torch.float64)) == 0


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda q, r: open_end(q[:0], r), ShapeError, "query with at least one sample"),
        (lambda q, r: open_end(q, r[:0]), ShapeError, "reference with at least one sample"),
        (lambda q, r: open_end(q, r[None]), ShapeError, "single reference"),
        (lambda q, r: open_end(q[:, :1], r), ShapeError, "query with shape"),
        (lambda q, r: open_end(q, r, torch.ones(1, 2, dtype=torch.bool)), ShapeError, "mask with the shape"),
        (lambda q, r: open_end(q, r, torch.ones_like(q)), InputError, "booleans"),
        (lambda q, r: open_end(q * math.nan, r), InputError, "finite numbers in query"),
        (lambda q, r: open_end(q, r * math.nan), InputError, "finite numbers in reference"),
        (lambda q, r: OpenEnd.start(r * math.nan), InputError, "finite numbers in reference"),
        (lambda q, r: open_end_batch(q[None], r, lengths=torch.tensor([5])), InputError, "between 1 and the 4"),
        (lambda q, r: open_end_batch(q[None], r, lengths=torch.tensor([0])), InputError, "between 1 and the 4"),
        (lambda q, r: dtw_cost(q[:, 0], r[None]), ShapeError, r"plans\[:, None\]"),
        (lambda q, r: dtw_cost(q, r), ShapeError, r"references\[None\]"),
        (lambda q, r: dtw_cost(q[:, :1], r[None]), ShapeError, "plans with shape"),
        (lambda q, r: dtw_cost(q, r[None], torch.tensor([1.0])), ShapeError, "lengths as integers"),
        (lambda q, r: dtw_cost(q, r[None], torch.tensor([1, 1])), ShapeError, "lengths as integers"),
        (lambda q, r: dtw_cost(q * math.inf, r[None]), InputError, "finite numbers in plans"),
        (lambda q, r: dtw_cost(q, r[None] * math.nan), InputError, "finite numbers in references"),
        (lambda q, r: dtw_cost(q, r[None], num_threads=0), InputError, "num_threads"),
        (lambda q, r: medoid(q), ShapeError, "trajectories with shape"),
        (lambda q, r: medoid(q[None][:0]), ShapeError, "trajectories with shape"),
        (lambda q, r: medoid(q[None] * math.nan), InputError, "finite numbers in trajectories"),
    ],
)
def test_refused(call, error, message):
    with pytest.raises(error, match=message):
        call(walk(33, 4, 2), walk(34, 5, 2))


def test_float32_and_unusual_layouts():
    plan, reference = walk(35, 10, 2), walk(36, 12, 2)
    assert torch.equal(open_end(plan.T.contiguous().T, reference.flip(0).flip(0))[1], open_end(plan, reference)[1])
    assert dtw_cost(plan.float(), reference[None].float()).dtype == torch.float64
    assert torch.equal(dtw_cost(plan.expand(4, 10, 2), reference[None])[3], dtw_cost(plan, reference[None]))
    wide = np.zeros((2, 3))
    wide[:, 1] = plan[0].numpy()
    alignment = OpenEnd.start(reference)
    stepped = alignment.step(wide[:, 1], np.ones(4, dtype=bool)[::2], alignment.initial)
    assert stepped[1] == float(open_end(plan[:1], reference)[1])


@pytest.mark.slow
def test_package_imports_without_numba():
    code = "import sys, eaip_prob.phase; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
