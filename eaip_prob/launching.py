"""What goes wrong where runs are launched, as one sentence: sweeps, workers, and jobs of SLURM."""

from __future__ import annotations

from eaip_prob.errors import EaipError, InputError
from eaip_prob.run_folder import ERROR

INTERRUPTED = (
    "Interrupted. The same command with the same run_dir goes on from here. Jobs at SLURM go on by themselves: wait "
    "until squeue shows none of them."
)


def of_a_sweep(error: EaipError) -> InputError:
    """Of the first run of a sweep that was refused; those that could run have.

    Example:
        >>> str(of_a_sweep(InputError("Expected a cube, got a ball.")))[:35]
        'Not all runs of the sweep finished;'
    """
    return InputError(
        f"Not all runs of the sweep finished; the first that did not: {error} Each has an {ERROR} in its folder. Start "
        "the same command again once it is mended; finished runs are kept."
    )


def of_a_cluster(error: Exception) -> InputError | None:
    """What SLURM, or the launcher that speaks to it, says of a job; None for what others raise.

    Example:
        >>> of_a_cluster(FileNotFoundError(2, "No such file or directory", "runs")) is None
        True
    """
    text = " ".join(str(error).split())
    if getattr(error, "filename", None) == "sbatch" or 'detect "srun"' in text:
        return InputError(
            "Expected SLURM's commands srun and sbatch, found none. Start this where they are, on a login node of the "
            "cluster, or choose hydra/launcher=joblib."
        )
    kinds = {kind.__name__ for kind in type(error).__mro__ if kind.__module__.startswith("submitit.")}
    if "FailedJobError" in kinds:
        return InputError(f"Expected SLURM to take the jobs, got: {text}. Mend hydra.launcher; nothing was started.")
    if "UncompletedJobError" in kinds:
        return InputError(
            f"Expected every job to end with a result, got: {text} Start the same command again; finished runs are "
            "kept."
        )
    return None
