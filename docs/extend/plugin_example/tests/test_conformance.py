"""The promises of a joint model, one test each."""

from __future__ import annotations

import pytest
from eaip_prob_robust import RobustJointModel

from eaip_prob.testing import Check, joint_model_checks


@pytest.mark.parametrize("check", joint_model_checks(RobustJointModel), ids=lambda check: check.__name__)
def test_promise(check: Check) -> None:
    """Raises where a promise is broken."""
    check()
