"""A linear-Gaussian interaction whose truth is known, and the dense formula of a conditioned Gaussian.

    scene s ~ N(0, I),  cause z ~ N(0, I)
    environment = C s,   human = A_h z + B_h s + own,   robot = A_r z + B_r s + own

all then scaled by units from 0.03 to 30 and moved away from zero. The scene tells of the robot what the human does not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from eaip_prob.gaussian import BlockGaussian, BlockLayout
from eaip_prob.observation import LinearObservation

SIZES = {"human": 5, "robot": 3, "environment": 2}
_NUM_CAUSES = 3
_OWN = 0.4  # standard deviation of what no cause explains


def draws(seed: int, *shape: int) -> Tensor:
    """Standard normal numbers."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@dataclass(frozen=True, eq=False)
class World:
    """The true distribution of the weights.

    Args:
        truth: mean and covariance of all blocks.
        root: (Z, ...), the covariance's root.
    """

    truth: BlockGaussian
    root: Float[Tensor, "joint causes"]

    @classmethod
    def default(cls) -> World:
        """The same one always."""
        layout = BlockLayout(SIZES)
        scale = torch.logspace(-1.5, 1.5, layout.total, dtype=torch.float64)[draws(1, layout.total).argsort()]
        causes, scene = draws(2, layout.total, _NUM_CAUSES), draws(3, layout.total, SIZES["environment"])
        own = _OWN * torch.eye(layout.total, dtype=torch.float64)
        features = layout.slice("environment")
        causes[features], own[features] = 0.0, 0.0
        scene[features] = torch.tensor([[1.0, 0.0], [0.6, 0.8]], dtype=torch.float64)
        root = scale[:, None] * torch.cat([causes, scene, own], -1)
        return cls(BlockGaussian(5.0 * scale * draws(4, layout.total), root @ root.mT, layout), root)

    @property
    def scale(self) -> Float[Tensor, "joint"]:
        """Standard deviation of each weight."""
        return self.truth.covariance.diagonal().sqrt()

    def rows(self, num: int, seed: int) -> Float[Tensor, "num joint"]:
        """Draws of all weights."""
        return self.truth.mean + draws(seed, num, self.root.shape[-1]) @ self.root.mT

    def blocks(self, rows: Tensor) -> dict[str, Tensor]:
        """Rows as {block: (..., K)}."""
        return {block: rows[..., self.truth.layout.slice(block)].clone() for block in self.truth.layout.names}

    def seen(
        self,
        blocks: Sequence[str],
        batch: Sequence[int] = (),
        num_rows: int = 3,
        seed: int = 0,
        noise: float = 0.5,
        correlated: bool = False,
    ) -> LinearObservation:
        """What one draw of the world shows of some blocks through random equations, with noise.

        Args:
            blocks: read by the equations.
            batch: leading axes.
            num_rows: M.
            seed: of everything that is drawn.
            noise: standard deviation of the rows, where the weights have one.
            correlated: whether the noise is a full covariance.
        """
        layout = self.truth.layout
        drawn = {block: self.rows(1, seed + 50)[0, layout.slice(block)] for block in blocks}
        matrices = {
            block: draws(seed + 10 * place, *batch, num_rows, layout.sizes[block]) / self.scale[layout.slice(block)]
            for place, block in enumerate(blocks)
        }
        offset = draws(seed + 60, *batch, num_rows)
        read = [(matrix @ drawn[block][:, None])[..., 0] for block, matrix in matrices.items()]
        value = sum(read, offset) + noise * draws(seed + 70, *batch, num_rows)
        variance = noise**2 * (0.5 + draws(seed + 80, *batch, num_rows).square())
        if correlated:
            root = noise * draws(seed + 90, *batch, num_rows, num_rows)
            variance = root @ root.mT + torch.diag_embed(variance)
        return LinearObservation(matrices, offset, value, variance, correlated=correlated)

    def whole(self, block: str, value: Float[Tensor, "*batch weights"], noise: float) -> LinearObservation:
        """A block as it is; `noise` in standard deviations of each weight."""
        scale = self.scale[self.truth.layout.slice(block)]
        variance = (noise * scale).square().expand(value.shape)
        eye = torch.eye(len(scale), dtype=torch.float64)
        return LinearObservation({block: eye}, torch.zeros_like(value), value, variance)


def dense_posterior(
    joint: BlockGaussian, observations: Sequence[LinearObservation]
) -> tuple[np.ndarray, np.ndarray, float]:
    """(mean, covariance, log density of what was observed) of one Gaussian, with every matrix written out.

        S = A Sigma A^T + R,   K = Sigma A^T S^-1
        mean + K r,   Sigma - K S K^T,   -(r^T S^-1 r + log det S + M log 2 pi) / 2,   r = y - offset - A mean

    Args:
        joint: mean (Z,).
        observations: without batch axes.
    """
    mean, covariance = joint.mean.numpy(), joint.covariance.numpy()
    design = np.concatenate([_design(joint.layout, seen.matrices, len(seen.value)) for seen in observations])
    residual = np.concatenate([(seen.value - seen.offset).numpy() for seen in observations]) - design @ mean
    noise, first = np.zeros((len(residual), len(residual))), 0
    for seen in observations:
        last = first + len(seen.value)
        noise[first:last, first:last] = seen.noise.numpy() if seen.correlated else np.diag(seen.noise.numpy())
        first = last
    innovation = design @ covariance @ design.T + noise
    gain = np.linalg.solve(innovation, design @ covariance).T
    log_det = 2.0 * np.log(np.diag(np.linalg.cholesky(innovation))).sum()
    squares = residual @ np.linalg.solve(innovation, residual)
    log_evidence = -0.5 * (squares + log_det + len(residual) * math.log(2.0 * math.pi))
    return mean + gain @ residual, covariance - gain @ innovation @ gain.T, float(log_evidence)


def _design(layout: BlockLayout, matrices: Mapping[str, Tensor], num_rows: int) -> np.ndarray:
    design = np.zeros((num_rows, layout.total))
    for block, matrix in matrices.items():
        design[:, layout.slice(block)] = matrix.numpy()
    return design


def member(seen: LinearObservation, index: tuple[int, ...]) -> LinearObservation:
    """One member of a batch of observations."""
    mask = None if seen.mask is None else seen.mask[index]
    matrices = {block: matrix[index] for block, matrix in seen.matrices.items()}
    return LinearObservation(matrices, seen.offset[index], seen.value[index], seen.noise[index], mask, seen.correlated)
