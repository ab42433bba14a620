"""Whether what `fit` returned can be used, asked once so that no prediction has to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from eaip_prob.checks import check_type
from eaip_prob.errors import EaipError, InputError, NotPositiveDefiniteError
from eaip_prob.gaussian import BlockGaussian
from eaip_prob.linalg import psd_root
from eaip_prob.models.base import AbstractJointModel
from eaip_prob.observation import LinearObservation


@contextmanager
def named(what: str) -> Iterator[None]:
    """Puts a name before the message of whatever of ours is raised inside; the class of the error stays.

    Example:
        >>> with named("MyModel.fit"):
        ...     raise InputError("Expected two demonstrations.")
        Traceback (most recent call last):
        ...
        eaip_prob.errors.InputError: In MyModel.fit: Expected two demonstrations.
    """
    try:
        yield
    except EaipError as error:
        raise type(error)(f"In {what}: {error}") from error


def check_learnt(model: Any, sizes: Mapping[str, int], target: str) -> None:
    """Refuses a fitted model whose prior, or posterior after an observation of one block, is no Gaussian.

    Args:
        model: what `fit` returned.
        sizes: {block: K} of the weights it was fitted to.
        target: the block that will be predicted.

    Raises:
        InputError: no joint model, or one of other blocks.
        NotPositiveDefiniteError: a covariance with NaN or a negative eigenvalue; the message names class and block.

    Example:
        >>> from eaip_prob.models import GaussianJointModel
        >>> rows = torch.randn(9, 2, generator=torch.Generator().manual_seed(0))
        >>> check_learnt(GaussianJointModel().fit({"human": rows, "robot": rows}), {"human": 2, "robot": 2}, "robot")
    """
    check_type("what fit returned", model, AbstractJointModel, "Let fit return the fitted model, not None.")
    name, prior = type(model).__name__, model.prior
    if dict(prior.layout.sizes) != dict(sizes):
        raise InputError(
            f"Expected of {name}.fit a model of the blocks {dict(sizes)}, got {dict(prior.layout.sizes)}. Learn the "
            "blocks that are given."
        )
    _check_semidefinite(f"the prior of {name}", prior)
    smallest = min(sizes, key=lambda block: sizes[block])  # which costs least
    with named(f"{name}.posterior"):
        answer = model.posterior([_itself(prior, smallest)], None, (target,)).components
    _check_semidefinite(f"the posterior of {name} after an observation of {smallest!r}", answer)


def _itself(prior: BlockGaussian, block: str) -> LinearObservation:
    """The block at its mean, with the noise of its own variance."""
    mean = prior.block_mean(block)
    eye = torch.eye(len(mean), dtype=mean.dtype)
    return LinearObservation({block: eye}, torch.zeros_like(mean), mean, prior.block_covariance(block).diagonal())


def _check_semidefinite(name: str, belief: BlockGaussian) -> None:
    problem = _problem(belief.covariance)
    if problem is None:
        return
    blocks = [block for block in belief.layout.names if _problem(belief.block_covariance(block)) is not None]
    where = f"in block {blocks[0]!r}" if blocks else "between its blocks"
    raise NotPositiveDefiniteError(
        f"Expected {name} with a positive semi-definite covariance, got {problem} {where}. Run "
        "eaip_prob.testing.joint_model_checks on the model."
    )


def _problem(covariance: Tensor) -> str | None:
    if not bool(torch.isfinite(covariance).all()):
        return "NaN or infinity"
    try:
        psd_root(covariance)
    except NotPositiveDefiniteError:
        scale = covariance.diagonal(dim1=-2, dim2=-1)
        if bool((scale < 0).any()):
            return f"a variance of {float(scale.amin()):.3g}"
        return f"an eigenvalue of {float(torch.linalg.eigvalsh(covariance).amin()):.3g}"
    return None
