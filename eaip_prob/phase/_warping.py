"""Compiled loops behind `phase.alignment`: unchecked arrays in, results written to the arrays meant for them.

Inner loops run over neighbouring memory without a dependency from one turn to the next, so that LLVM
vectorises them; slices passed to small functions spare it the check for negative indices.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit

LANES = 8


def pair_costs(plans: np.ndarray, references: np.ndarray, lengths: np.ndarray, num_threads: int) -> np.ndarray:
    """Closed costs (R, P) of plans (P, T_p, D) and padded references (R, T_r, D), shared between threads."""
    cost = np.empty((len(references), len(plans)))
    num_blocks = -(-cost.size // LANES)
    bounds = [min(cost.size, LANES * (num_blocks * part // num_threads)) for part in range(num_threads + 1)]

    def fill(first: int, last: int) -> None:
        _closed_costs(plans, references, lengths, first, last, cost.reshape(-1))

    if num_threads == 1:
        fill(0, cost.size)
        return cost
    with ThreadPoolExecutor(num_threads) as pool:
        list(pool.map(fill, bounds[:-1], bounds[1:]))
    return cost


@njit(cache=True, nogil=True)
def next_column(sample, mask, columns, last, column):
    """(t*, cost) after one more sample (D,); `column` becomes the successor of `last`, both (T_r,)."""
    column[:] = 0.0
    for d in range(columns.shape[0]):
        if mask[d]:
            _add_squares(column, columns[d], sample[d])
    for j in range(column.shape[0]):
        column[j] = math.sqrt(column[j])
    # Costs are finite, so an infinite state can only be the one before the first sample.
    first = last[0] == np.inf
    left = 0.0 if first else np.inf
    diagonal = np.inf
    end_index, least = 0, np.inf
    for j in range(column.shape[0]):
        before = left
        before = last[j] if last[j] < before else before
        before = diagonal if diagonal < before else before
        diagonal = last[j]
        left = column[j] + before
        column[j] = left
        # NaN must get through, so that the caller can refuse it: NaN >= least is False.
        if j == 0 or not left >= least:
            end_index, least = j, left
    return end_index, least


@njit(cache=True, nogil=True)
def _add_squares(squares, row, value):
    for j in range(squares.shape[0]):
        difference = row[j] - value
        squares[j] += difference * difference


@njit(cache=True, nogil=True)
def all_columns(queries, mask, columns, end_index, cost):
    """`next_column` over queries (N, T_q, D); fills end_index and cost, both (N, T_q)."""
    last, column = np.empty(columns.shape[1]), np.empty(columns.shape[1])
    for n in range(queries.shape[0]):
        last[:] = np.inf
        for i in range(queries.shape[1]):
            end_index[n, i], cost[n, i] = next_column(queries[n, i], mask[n, i], columns, last, column)
            last, column = column, last


@njit(cache=True, nogil=True)
def _closed_costs(plans, references, lengths, first, last, cost):
    """Fills cost[first:last] of the flat (R, P) costs of plans (P, T_p, D) and references (R, T_r, D).

    LANES pairs go side by side, with their samples interleaved; an odd number of signals gets one of zeros.
    """
    num_plans, num_rows, num_signals = plans.shape
    num_even = num_signals + num_signals % 2
    plan = np.zeros((num_even, num_rows * LANES))
    reference = np.zeros((num_even, lengths.max() * LANES))
    diagonals = np.empty((3, (num_rows + 1) * LANES))
    squares = np.zeros(num_rows * LANES)
    ends = np.empty(LANES, np.int64)
    for start in range(first, last, LANES):
        size = min(LANES, last - start)
        longest = 0
        for k in range(LANES):
            ends[k] = lengths[min(start + k, last - 1) // num_plans]
            longest = max(longest, ends[k])
        for k in range(LANES):
            pair = min(start + k, last - 1)
            _interleave(plan, plans[pair % num_plans], k)
            _interleave_reversed(reference, references[pair // num_plans], k, longest)
        _block(plan, reference, longest, ends[:size], diagonals, squares, cost[start : start + size])


@njit(cache=True, nogil=True)
def _interleave(lanes, samples, k):
    for i in range(samples.shape[0]):
        for d in range(samples.shape[1]):
            lanes[d, i * LANES + k] = samples[i, d]


@njit(cache=True, nogil=True)
def _interleave_reversed(lanes, samples, k, length):
    for j in range(length):
        for d in range(samples.shape[1]):
            lanes[d, (length - 1 - j) * LANES + k] = samples[j, d]


@njit(cache=True, nogil=True)
def _block(plan, reference, num_columns, ends, diagonals, squares, cost):
    # Sweeps anti-diagonals i + j = s, whose cells do not depend on each other. Entry i + 1 of a diagonal is row
    # i; the entry just below the rows in use is an infinite wall, those above have not been written yet.
    num_signals, num_rows = plan.shape[0], plan.shape[1] // LANES
    diagonals[:] = np.inf
    older, old, new = diagonals[0], diagonals[1], diagonals[2]
    older[:LANES] = 0.0
    for s in range(num_rows + num_columns - 1):
        low, high = max(0, s - num_columns + 1) * LANES, min(num_rows, s + 1) * LANES
        left, right = low + (num_columns - 1 - s) * LANES, high + (num_columns - 1 - s) * LANES
        square = squares[: high - low]
        if num_signals > 2:
            square[:] = 0.0
        for d in range(2, num_signals, 2):
            e = d + 1
            _add_two(square, plan[d, low:high], reference[d, left:right], plan[e, low:high], reference[e, left:right])
        _advance(
            new[low + LANES : high + LANES],
            square,
            plan[0, low:high],
            reference[0, left:right],
            plan[1, low:high],
            reference[1, left:right],
            old[low + LANES : high + LANES],
            old[low:high],
            older[low:high],
        )
        new[low : low + LANES] = np.inf
        for k in range(ends.shape[0]):
            if s == num_rows + ends[k] - 2:
                cost[k] = new[num_rows * LANES + k]
        older, old, new = old, new, older


@njit(cache=True, nogil=True)
def _add_two(squares, plan_a, reference_a, plan_b, reference_b):
    for i in range(squares.shape[0]):
        a, b = plan_a[i] - reference_a[i], plan_b[i] - reference_b[i]
        squares[i] += a * a + b * b


@njit(cache=True, nogil=True)
def _advance(new, squares, plan_a, reference_a, plan_b, reference_b, above, beside, diagonal):
    # Two signals are taken here: their loads hide behind the square root. More arrays than these, and LLVM
    # gives up proving that `new` overlaps none of them.
    for i in range(new.shape[0]):
        a, b = plan_a[i] - reference_a[i], plan_b[i] - reference_b[i]
        before = above[i]
        before = beside[i] if beside[i] < before else before
        before = diagonal[i] if diagonal[i] < before else before
        new[i] = math.sqrt(squares[i] + (a * a + b * b)) + before
