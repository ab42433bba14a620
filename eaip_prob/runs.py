"""What every experiment script shares: its configuration, its run folder, and how it ends.

A script in `experiments/` is a docstring and one function from a configuration to metrics:

    @experiment("passing_over")
    def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]: ...

    if __name__ == "__main__":
        run()

`run()` reads the command line with Hydra and leaves `config.yaml`, `environment.json` and, last of all,
`metrics.json` in the run folder; so a folder with metrics is a finished run, and it is never written to again.
This module imports neither torch nor Hydra at its top, which keeps `--help` fast.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.config import check_kinds, conf_dir, hydra_hands_errors_on, refusal
from eaip_prob.errors import EaipError, InputError, MissingDataError
from eaip_prob.provenance import description

if TYPE_CHECKING:
    from omegaconf import DictConfig

    Body = Callable[[DictConfig, Path], Mapping[str, Any]]

METRICS, CONFIG, ENVIRONMENT = "metrics.json", "config.yaml", "environment.json"
EXIT_INPUT = 2


@dataclass(frozen=True)
class Experiment:
    """An experiment: called without arguments it reads the command line and runs.

    Args:
        name: its primary config, `<name>.yaml` in `conf`.
        unwrapped: the decorated function, (cfg, folder) -> metrics.
        conf: folder of configuration files.
    """

    name: str
    unwrapped: Body
    conf: Path

    def __call__(self) -> None:
        """Reads the command line, runs and ends the process with 0, or with 2 where the input was refused."""
        import hydra
        from hydra.errors import HydraException

        if {"-h", "--help"} & set(sys.argv[1:]):
            print(textwrap.dedent(self.description).strip(), end="\n\n")
        main = hydra.main(version_base="1.3", config_path=str(self.conf.resolve()), config_name=self.name)
        started: list[DictConfig] = []

        def job(cfg: DictConfig) -> None:
            started.append(cfg)
            self._job(cfg, full)

        with hydra_hands_errors_on() as full:
            try:
                main(job)()
            except HydraException as error:
                _refuse(refusal(error), full)
            except OSError as error:
                if started:
                    raise
                _refuse(InputError(f"Expected run_dir as a folder, or a new one, got: {error}. Choose another."), full)

    @property
    def description(self) -> str:
        """The docstring of the script, else of the function."""
        module = sys.modules.get(self.unwrapped.__module__)
        return (module and module.__doc__) or self.unwrapped.__doc__ or self.name

    def compose(self, overrides: list[str] | None = None) -> DictConfig:
        """The configuration that a command line with these overrides gives, for tests and notebooks.

        Raises:
            hydra.errors.HydraException: an override that no key or group answers to.
        """
        from hydra import compose, initialize_config_dir
        from hydra.core.global_hydra import GlobalHydra

        inside_a_run = GlobalHydra.instance().is_initialized()
        folder = str(self.conf.resolve())
        with contextlib.nullcontext() if inside_a_run else initialize_config_dir(folder, version_base="1.3"):
            return compose(self.name, overrides or [])

    def execute(self, cfg: DictConfig, folder: Path) -> dict[str, float] | None:
        """Runs into a folder, as the command line does.

        Args:
            cfg: the configuration, without Hydra's own node.
            folder: made if it is absent.

        Returns:
            the flat metrics, or None where the folder holds a finished run of the same configuration.

        Raises:
            InputError: the folder belongs to a run of another configuration, or a metric is not a finite number.
            MissingDataError: recorded data are absent.
        """
        folder.mkdir(parents=True, exist_ok=True)
        config = _resolved(cfg)
        check_kinds(cfg, self.compose())
        if _is_finished(folder, config):
            return None
        write_text(folder / CONFIG, config)
        write_text(folder / ENVIRONMENT, json.dumps(description(cfg.get("seed")), indent=2, sort_keys=True) + "\n")
        try:
            with torch_threads(_num_threads(cfg)):
                metrics = flat_metrics(self.unwrapped(cfg, folder))
        except EaipError:
            _leave_unstarted(folder)
            raise
        write_text(folder / METRICS, json.dumps(metrics, indent=2, sort_keys=True, allow_nan=False) + "\n")
        return metrics

    def _job(self, cfg: DictConfig, full: bool) -> None:
        from hydra.core.hydra_config import HydraConfig

        folder = Path(HydraConfig.get().runtime.output_dir)
        try:
            # Read when torch is imported, which is yet to come.
            os.environ["OMP_NUM_THREADS"] = str(_num_threads(cfg))
            metrics = self.execute(cfg, folder)
        except MissingDataError as error:
            print(error)
            return
        except EaipError as error:
            _refuse(error, full)
        else:
            note = "" if metrics is not None else " (finished before, left as it is; choose another run_dir to repeat)"
            print(f"Results are in {os.path.relpath(folder)}{note}.")


def experiment(name: str, conf: Path | None = None) -> Callable[[Body], Experiment]:
    """Decorator that makes a function (cfg, folder) -> metrics an experiment with a command line.

    Args:
        name: its primary config, without `.yaml`.
        conf: folder of configuration files; default the package's own.

    Example:
        >>> @experiment("base")
        ... def run(cfg, folder):
        ...     return {"error": {"rmse": 0.5}}
        >>> run.compose(["seed=3"]).seed
        3
    """

    def decorate(body: Body) -> Experiment:
        return Experiment(name, body, conf or conf_dir())

    return decorate


def flat_metrics(metrics: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """Nested metrics as one sorted level, keys joined by "/".

    Raises:
        InputError: a value is not one finite number, or two values end under one key.

    Example:
        >>> flat_metrics({"eaip": {"rmse": 1, "nll": 0.5}})
        {'eaip/nll': 0.5, 'eaip/rmse': 1.0}
    """
    pairs: list[tuple[str, float]] = []
    for key, value in metrics.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            pairs += flat_metrics(value, f"{name}/").items()
        else:
            pairs.append((name, _number(name, value)))
    flat = dict(sorted(pairs))
    if len(flat) < len(pairs):
        raise InputError(f"Expected different metrics keys, got one twice among {sorted(key for key, _ in pairs)}.")
    return flat


def _number(name: str, value: Any) -> float:
    try:
        number = float("nan") if isinstance(value, str) else float(value)
    except (TypeError, ValueError, RuntimeError):  # RuntimeError: a tensor with several entries
        number = float("nan")
    if number in (float("inf"), float("-inf")) or number != number:
        raise InputError(
            f"Expected one finite number as metric {name!r}, got {value!r}. Leave the key out where it has no value."
        )
    return number


def write_text(path: Path, text: str) -> None:
    """Writes a file in one step: a reader, or a process that was stopped, sees all of it or nothing."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Gives torch this many threads inside the block; small operations on busy cores are far faster on one."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _resolved(cfg: DictConfig) -> str:
    from omegaconf import OmegaConf, open_dict
    from omegaconf.errors import OmegaConfBaseException

    config = cfg.copy()
    with open_dict(config):
        config.pop("run_dir", None)  # where results lie is no part of what they are
    try:
        return OmegaConf.to_yaml(config, resolve=True, sort_keys=True)
    except OmegaConfBaseException as error:
        raise InputError(f"Expected a configuration without open references, got: {error}. Mend that key.") from error


def _is_finished(folder: Path, config: str) -> bool:
    stored = folder / CONFIG
    finished = (folder / METRICS).exists()
    if not stored.exists() and not finished:
        return False
    if not stored.exists() or stored.read_text(encoding="utf-8") != config:
        raise InputError(
            f"Expected run folder {folder.name!r} to be empty or of the same configuration, got one of another "
            f"configuration (its {CONFIG} differs). Choose another run_dir; nothing was overwritten."
        )
    return finished


def _num_threads(cfg: DictConfig) -> int:
    count = cfg.get("threads", 1)
    if not isinstance(count, int) or count < 1:
        raise InputError(f"Expected threads as an integer of at least 1, got {count!r}.")
    return count


def _leave_unstarted(folder: Path) -> None:
    """Removes what describes a run that was refused before it left anything, so that its folder can be used."""
    if {path.name for path in folder.iterdir()} == {CONFIG, ENVIRONMENT}:
        (folder / CONFIG).unlink()
        (folder / ENVIRONMENT).unlink()


def _refuse(error: EaipError, full: bool) -> None:
    if full:
        traceback.print_exception(error)
    print(error, file=sys.stderr)
    sys.exit(EXIT_INPUT)
