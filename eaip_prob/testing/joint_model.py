"""What every joint model promises, as checks: those that apply to a model are chosen by what it declares."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from eaip_prob.checks import check_type
from eaip_prob.errors import InputError
from eaip_prob.models import AbstractJointModel
from eaip_prob.testing import conditioning_checks, input_checks, learning_checks, numerics_checks
from eaip_prob.testing.check import Check
from eaip_prob.testing.subject import Subject

_OF_ALL = (
    input_checks.check_not_fitted,
    input_checks.check_fit_is_pure,
    input_checks.check_posterior_is_pure,
    input_checks.check_bad_demonstrations,
    input_checks.check_bad_observations,
    input_checks.check_float32,
    input_checks.check_globals,
    input_checks.check_candidates,
    conditioning_checks.check_prior,
    conditioning_checks.check_shapes,
    conditioning_checks.check_batch_is_loop,
    conditioning_checks.check_order_of_observations,
    conditioning_checks.check_hypotheses,
    conditioning_checks.check_masked_rows,
    conditioning_checks.check_vague_observation,
    conditioning_checks.check_exact_observation,
    numerics_checks.check_definite,
    numerics_checks.check_few_demonstrations,
    numerics_checks.check_units,
    numerics_checks.check_order_of_demonstrations,
    numerics_checks.check_order_of_blocks,
    numerics_checks.check_absent_blocks,
    numerics_checks.check_identity_grams,
    numerics_checks.check_deterministic,
    numerics_checks.check_state,
    learning_checks.check_learns_the_mean,
    learning_checks.check_coverage,
    learning_checks.check_scene_helps,
    learning_checks.check_evidence,
)
_OF_CONDITIONED_PRIOR = (
    conditioning_checks.check_dense_formula,
    conditioning_checks.check_one_after_the_other,
    conditioning_checks.check_variance_never_grows,
)
_OF_MISSING = (learning_checks.check_missing,)
_OF_NONE_MISSING = (learning_checks.check_missing_refused,)


def joint_model_checks(
    make: Callable[[], AbstractJointModel], known_failures: Mapping[str, str] | None = None
) -> list[Check]:
    """Tests of every promise of a joint model, each a callable with a name; call them in any order.

    Fits are made when first needed and shared by the checks of one call.

    Args:
        make: gives a new model, not yet fitted, always with the same settings.
        known_failures: {`check_<promise>`: why the model does not keep it}; such a check fails when it starts to pass.

    Raises:
        InputError: no joint model, or a known failure of a check that the model is not asked.

    Example:
        In a test file::

            @pytest.mark.parametrize("check", joint_model_checks(MyModel), ids=lambda check: check.__name__)
            def test_my_model(check):
                check()

        >>> from eaip_prob.models import GaussianJointModel
        >>> check = joint_model_checks(GaussianJointModel)[0]
        >>> check.__name__, check.promise
        ('check_not_fitted', 'Before `fit`, `posterior`, `prior` and `state` raise NotFittedError.')
        >>> check()
    """
    model, known_failures = make(), known_failures or {}
    check_type("make()", model, AbstractJointModel, "Pass a function that returns a new model.")
    functions = [*_OF_ALL, *(_OF_MISSING if model.supports_missing else _OF_NONE_MISSING)]
    if model.conditions_prior:
        functions += _OF_CONDITIONED_PRIOR
    names = [function.__name__ for function in functions]
    unknown = sorted(set(known_failures) - set(names))
    if unknown:
        raise InputError(
            f"Expected known failures among the checks of {type(model).__name__}, {names}, got {unknown}. Mend the "
            "names."
        )
    subject = Subject(make)
    return [Check(function, subject, known_failures.get(function.__name__)) for function in functions]
