"""One promise, tested on one model: a failure says which promise, what came and what to do."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

from eaip_prob.errors import NumericalWarning
from eaip_prob.testing.subject import Subject


@dataclass(frozen=True, eq=False)
class Check:
    """A check bound to a model; calling it tests the promise.

    Args:
        function: `check_<promise>`, whose docstring's first line is the promise.
        subject: the model under test, with what it was fitted to.
        known_failure: why the model does not keep the promise; None where it should.

    Example:
        >>> from eaip_prob.models import GaussianJointModel
        >>> from eaip_prob.testing import joint_model_checks
        >>> check = joint_model_checks(GaussianJointModel)[0]
        >>> check.__name__, check() is None
        ('check_not_fitted', True)
    """

    function: Callable[[Subject], None]
    subject: Subject
    known_failure: str | None = None

    @property
    def __name__(self) -> str:
        """`check_<promise>`, for the ids of pytest."""
        return self.function.__name__

    @property
    def promise(self) -> str:
        """What is promised, in a sentence."""
        return (self.function.__doc__ or "").split("\n")[0]

    def __call__(self) -> None:
        """Tests the promise; of a known failure, that it is still one.

        Raises:
            AssertionError: a broken promise, or a known failure that does not fail.
        """
        broken = self._broken()
        if broken is not None and self.known_failure is None:
            raise broken
        if broken is None and self.known_failure is not None:
            raise AssertionError(
                f"Expected {self.__name__} to fail for {self.subject.name}, because {self.known_failure.rstrip('.')}, "
                "but it passed. Remove it from known_failures."
            )

    def _broken(self) -> AssertionError | None:
        try:
            with warnings.catch_warnings():
                # Nothing here is so badly conditioned that a sound model needs a correction of round-off.
                warnings.simplefilter("error", NumericalWarning)
                self.function(self.subject)
        except AssertionError as error:
            return self._explained(str(error), error)
        except Exception as error:
            came = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(".")
            return self._explained(f"{came}; call the model as {self.__name__} does to see where it comes from", error)
        return None

    def _explained(self, came: str, error: Exception) -> AssertionError:
        explained = AssertionError(
            f"Expected of {self.subject.name} ({self.__name__}): {self.promise.rstrip('.')}; got {came.rstrip('.')}."
        )
        explained.__cause__ = error
        return explained
