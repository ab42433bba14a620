"""Dynamic time warping: how far along a reference a motion is, and how far apart two whole motions are.

Steps are (1, 0), (0, 1) and (1, 1), all of weight one (Sakoe & Chiba 1978, symmetric1), between samples at
Euclidean distance d over the observed signals. With D[i, j] the cost of the best path from (0, 0) to (i, j),

    D[i, j] = d[i, j] + min(D[i-1, j], D[i, j-1], D[i-1, j-1]).

Open end (Eq. 5): t* = argmin_j D[i, j], the prefix of the reference closest to the first i + 1 samples seen.
Closed: D[T_q - 1, T_r - 1]. Costs have the signals' unit; nothing is divided by the length of the path.

Importing this module imports numba; kernels compile at their first call and are cached on disk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from eaip_prob.checks import as_bool, check_finite, check_shape
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.phase import _warping
from eaip_prob.phase._alignment_inputs import (
    array,
    checked_lengths,
    checked_signals,
    checked_stack,
    read_only,
    reference_columns,
    within,
)


@dataclass(frozen=True, eq=False)
class OpenEnd:
    """Open-end alignment of samples that arrive one by one, for control loops: numpy in, numpy out.

    Made by `OpenEnd.start(reference)`; equals `open_end` to the last digit. The state is the last column of D,
    a read-only array of T_r costs; before the first sample all of it is infinite.

    Args:
        columns: (D, T_r), the reference, one row per signal.
        initial: (T_r,), the state before the first sample.

    Example:
        >>> alignment = OpenEnd.start(torch.linspace(0.0, 1.0, 11, dtype=torch.float64)[:, None])
        >>> state, seen = alignment.initial, np.array([True])
        >>> for value in (0.0, 0.1, 0.2):
        ...     end_index, cost, state = alignment.step(np.array([value]), seen, state)
        >>> end_index
        2
    """

    columns: Float[np.ndarray, "signals reference"]
    initial: Float[np.ndarray, " reference"]

    @classmethod
    def start(cls, reference: Float[Tensor, "reference signals"]) -> OpenEnd:
        """An alignment to one reference (T_r, D), in the unit of the samples to come.

        Raises:
            ShapeError: not (T_r, D), or empty.
            InputError: NaN or infinity in the reference.
        """
        columns = reference_columns(reference)
        return cls(columns, read_only(np.full(columns.shape[1], np.inf)))

    def step(
        self,
        sample: Float[np.ndarray, " signals"],
        mask: Bool[np.ndarray, " signals"],
        state: Float[np.ndarray, " reference"],
    ) -> tuple[int, float, Float[np.ndarray, " reference"]]:
        """(t*, its cost, the next state) after one more sample; nothing that is passed in is changed.

        Args:
            sample: (D,), in the reference's unit; anything where the mask is False.
            mask: (D,) booleans, True = observed; a sample without any costs nothing.
            state: (T_r,), `initial` or what the last step returned.

        Raises:
            ShapeError: sample, mask or state of another size.
            InputError: NaN or infinity where the mask is True, or a mask that is not boolean.
        """
        # Copies are contiguous and writable: any other layout would make numba compile once more.
        sample = np.array(sample, dtype=np.float64)
        mask = np.array(mask)
        shape = self.columns.shape[:1]
        if sample.shape != shape or mask.shape != shape or state.shape != self.initial.shape or mask.dtype != np.bool_:
            raise self._refusal(sample, mask, state)
        column = np.empty(state.shape)
        if state.flags.writeable:
            state = read_only(state.copy())
        end_index, cost = _warping.next_column(sample, mask, self.columns, state, column)
        if not cost < np.inf:
            raise InputError(
                f"Expected finite numbers in sample where mask is True, got {sample}. "
                "Mark missing signals with mask=False."
            )
        column.flags.writeable = False
        return end_index, cost, column

    def _refusal(self, sample: np.ndarray, mask: np.ndarray, state: np.ndarray) -> InputError:
        if mask.dtype != np.bool_:
            return InputError(
                f"Expected mask as booleans (True = observed), got dtype {mask.dtype}. Compare explicitly."
            )
        num_signals, length = self.columns.shape
        return ShapeError(
            f"Expected sample and mask with shape ({num_signals},) and state with shape ({length},), "
            f"got {sample.shape}, {mask.shape} and {state.shape}. Start from OpenEnd.start(reference).initial."
        )


def open_end(
    query: Float[Tensor, "*batch query signals"],
    reference: Float[Tensor, "reference signals"],
    mask: Bool[Tensor, "*batch query signals"] | None = None,
) -> tuple[Int[Tensor, "*batch query"], Float[Tensor, "*batch query"]]:
    """For every prefix of the query the reference index t* whose prefix is closest, and that cost.

    Ties go to the smallest index. Distances are plain sums over the observed signals, without rescaling for
    hidden ones: a sample with fewer signals weighs less, one with none costs nothing and leaves t* in place.
    As every cell of a path costs, a query much faster than the reference gets a t* slightly behind.

    Args:
        query: (*batch, T_q, D), in the reference's unit.
        reference: (T_r, D), every signal observed.
        mask: of the query's shape, True = observed; default everything. Values under False are never read.

    Returns:
        end_index (*batch, T_q) in 0 .. T_r - 1, and cost (*batch, T_q) in the signals' unit.

    Raises:
        ShapeError: no samples, other numbers of signals, or a mask of another shape.
        InputError: NaN or infinity in the reference, or in the query where the mask is True.

    Example:
        >>> reference = torch.linspace(0.0, 1.0, 11, dtype=torch.float64)[:, None]
        >>> open_end(reference[:4], reference)[0]
        tensor([0, 1, 2, 3])
    """
    columns, query = reference_columns(reference), checked_signals("query", query)
    check_shape("query", query, ["T", len(columns)])
    mask = torch.ones_like(query, dtype=torch.bool) if mask is None else as_bool("mask", mask)
    if mask.shape != query.shape:
        raise ShapeError(f"Expected mask with the shape of query, {tuple(query.shape)}, got {tuple(mask.shape)}.")
    check_finite("query", query, where=mask)
    flat = query.reshape(-1, *query.shape[-2:])
    end_index = np.empty(flat.shape[:2], dtype=np.int64)
    cost = np.empty(flat.shape[:2])
    _warping.all_columns(array(flat), array(mask.reshape(flat.shape)), columns, end_index, cost)
    return torch.from_numpy(end_index).reshape(query.shape[:-1]), torch.from_numpy(cost).reshape(query.shape[:-1])


def open_end_batch(
    query: Float[Tensor, "*batch query signals"],
    reference: Float[Tensor, "reference signals"],
    mask: Bool[Tensor, "*batch query signals"] | None = None,
    lengths: Int[Tensor, "*batch"] | None = None,
) -> Int[Tensor, "*batch query"]:
    """The t* (*batch, T_q) of `open_end` for padded queries; past a query's length its last t* is held.

    Args:
        query: (*batch, T_q, D), in the reference's unit.
        reference: (T_r, D).
        mask: of the query's shape, True = observed; default everything.
        lengths: (*batch,), number of samples of each query; default T_q.

    Raises:
        ShapeError: as `open_end`, or lengths of another shape.
        InputError: as `open_end`, or lengths outside 1 .. T_q.

    Example:
        >>> reference = torch.linspace(0.0, 1.0, 11, dtype=torch.float64)[:, None]
        >>> open_end_batch(reference[None, :4], reference, lengths=torch.tensor([2]))
        tensor([[0, 1, 1, 1]])
    """
    query = checked_signals("query", query)
    inside = within(checked_lengths(lengths, query), query)
    return open_end(query, reference, inside if mask is None else inside & as_bool("mask", mask))[0]


def dtw_cost(
    plans: Float[Tensor, "*batch plan signals"],
    references: Float[Tensor, "references reference signals"],
    lengths: Int[Tensor, " references"] | None = None,
    num_threads: int = 1,
) -> Float[Tensor, "*batch references"]:
    """Summed Euclidean cost (*batch, R) along the best path between both ends of each plan and each reference.

    Args:
        plans: (*batch, T_p, D), all samples observed.
        references: (R, T_r, D), in the plans' unit, padded at the end.
        lengths: (R,), number of samples of each reference; default T_r. Values past it are never used.
        num_threads: threads that share the pairs; the result does not depend on it.

    Raises:
        ShapeError: no samples, other numbers of signals, or lengths of another shape.
        InputError: NaN or infinity within the lengths, lengths outside 1 .. T_r, or no thread.

    Example:
        >>> path = torch.tensor([[0.0], [1.0], [2.0]], dtype=torch.float64)
        >>> dtw_cost(path, torch.stack([path, path + 5.0]))
        tensor([ 0., 15.], dtype=torch.float64)
    """
    plans, references = checked_signals("plans", plans), checked_stack("references", references)
    check_shape("plans", plans, ["T", references.shape[-1]])
    if num_threads < 1:
        raise InputError(f"Expected num_threads of at least 1, got {num_threads}.")
    counts = checked_lengths(lengths, references)
    check_finite("plans", plans)
    check_finite("references", references, where=within(counts, references))
    flat = array(plans.reshape(-1, *plans.shape[-2:]))
    cost = _warping.pair_costs(flat, array(references), array(counts), num_threads)
    return torch.from_numpy(cost).T.reshape(*plans.shape[:-2], len(references))


def medoid(trajectories: Float[Tensor, "N time signals"], lengths: Int[Tensor, " N"] | None = None) -> int:
    """Index of the trajectory with the least summed closed cost to all others; the first one on ties.

    Args:
        trajectories: (N, T, D), one unit, padded at the end.
        lengths: (N,), number of samples of each; default T. Values past it are never used.

    Raises:
        ShapeError: not (N, T, D), empty, or lengths of another shape.
        InputError: NaN or infinity within the lengths, or lengths outside 1 .. T.

    Example:
        >>> slopes = torch.tensor([1.0, 5.0, 2.0], dtype=torch.float64)
        >>> medoid(slopes[:, None, None] * torch.linspace(0.0, 1.0, 9, dtype=torch.float64)[:, None])
        2
    """
    trajectories = checked_stack("trajectories", trajectories)
    num_samples = checked_lengths(lengths, trajectories)
    check_finite("trajectories", trajectories, where=within(num_samples, trajectories))
    counts, values = array(num_samples), array(trajectories)
    total = np.zeros(len(values))
    for i in range(len(values) - 1):
        one = np.ascontiguousarray(values[i : i + 1, : counts[i]])
        cost = _warping.pair_costs(one, values[i + 1 :], counts[i + 1 :], num_threads=1)[:, 0]
        total[i] += cost.sum()
        total[i + 1 :] += cost
    return int(total.argmin())
