from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch


@pytest.fixture(autouse=True)
def _no_global_change() -> Iterator[None]:
    dtype, threads = torch.get_default_dtype(), torch.get_num_threads()
    torch_rng, numpy_rng = torch.get_rng_state(), np.random.get_state()
    yield
    changed: list[str] = []
    if torch.get_default_dtype() != dtype:
        changed.append("torch's default dtype")
        torch.set_default_dtype(dtype)
    if torch.get_num_threads() != threads:
        changed.append("torch's number of threads")
        torch.set_num_threads(threads)
    if not torch.equal(torch.get_rng_state(), torch_rng):
        changed.append("torch's global random state (pass a torch.Generator)")
        torch.set_rng_state(torch_rng)
    if not _same_numpy_state(np.random.get_state(), numpy_rng):
        changed.append("numpy's global random state (use np.random.default_rng)")
        np.random.set_state(numpy_rng)
    if changed:
        pytest.fail(f"The test changed {', '.join(changed)}.", pytrace=False)


def _same_numpy_state(one: Any, other: Any) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
