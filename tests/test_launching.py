from __future__ import annotations

import pytest

from eaip_prob.errors import InputError
from eaip_prob.launching import of_a_cluster, of_a_sweep


def lost(name: str) -> Exception:
    submitit = pytest.importorskip("submitit")
    return getattr(submitit.core.utils, name)("Job 7 (task: 0)\nended (state: CANCELLED by 0)")


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (FileNotFoundError(2, "No such file or directory", "sbatch"), "srun and sbatch, found none.*joblib"),
        (RuntimeError('Could not detect "srun", are you indeed on a slurm cluster?'), "srun and sbatch, found none"),
        (lost("FailedJobError"), "to take the jobs, got: Job 7 .task: 0. ended .*Mend hydra.launcher"),
        (
            lost("UncompletedJobError"),
            "to end with a result, got: Job 7 .*CANCELLED by 0. Start the same command again",
        ),
    ],
)
def test_what_a_cluster_says_is_one_sentence(error, message):
    said = of_a_cluster(error)
    assert isinstance(said, InputError) and "\n" not in str(said)
    with pytest.raises(InputError, match=message):
        raise said


@pytest.mark.parametrize("error", [RuntimeError("bug"), FileNotFoundError(2, "none", "file"), OSError(28, "full")])
def test_what_others_raise_is_left_to_them(error):
    assert of_a_cluster(error) is None


def test_a_sweep_names_the_first_that_did_not_finish():
    with pytest.raises(InputError, match="did not: no ball. Each has an error.txt .* finished runs are kept"):
        raise of_a_sweep(InputError("no ball."))
