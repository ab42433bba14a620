"""What every experiment script shares: its configuration, its command line, sweeps, and how it ends.

A script in `experiments/` is a docstring and one function from a configuration to metrics:

    @experiment("passing_over")
    def run(cfg: DictConfig, folder: Path) -> Mapping[str, Any]: ...

    if __name__ == "__main__":
        run()

`run()` reads the command line with Hydra and leaves what `eaip_prob.run_folder` describes. With `-m` it is a sweep: one
folder a run, in which finished runs are left alone, so that the same command goes on where it was interrupted.
This module imports neither torch nor Hydra at its top, which keeps `--help` fast.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eaip_prob.config import check_kinds, conf_dir, hydra_hands_errors_on, refusal
from eaip_prob.errors import EaipError, InputError, MissingDataError, StorageError
from eaip_prob.launching import INTERRUPTED, of_a_cluster, of_a_sweep
from eaip_prob.provenance import description
from eaip_prob.run_folder import RunFolder, flat_metrics

if TYPE_CHECKING:
    from omegaconf import DictConfig

    Body = Callable[[DictConfig, Path], Mapping[str, Any]]

EXIT_INPUT, EXIT_INTERRUPTED = 2, 130
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)


@dataclass(frozen=True)
class Experiment:
    """An experiment: called without arguments it reads the command line and runs.

    Args:
        name: its primary config, `<name>.yaml` in `conf`.
        unwrapped: the decorated function, (cfg, folder) -> metrics.
        conf: folder of configuration files.
        repeatable: run again where it has finished and replace its own files, as a report of other runs does.
    """

    name: str
    unwrapped: Body
    conf: Path
    repeatable: bool = False

    def __call__(self) -> None:
        """Reads the command line, runs and ends the process with 0, or with 2 where the input was refused."""
        import hydra
        from hydra.errors import HydraException
        from omegaconf.errors import OmegaConfBaseException

        from eaip_prob import plugins

        if {"-h", "--help"} & set(sys.argv[1:]):
            print(textwrap.dedent(self.description).strip(), end="\n\n")
        plugins.register()
        main = hydra.main(version_base="1.3", config_path=str(self.conf.resolve()), config_name=self.name)
        started: list[DictConfig] = []

        def job(cfg: DictConfig) -> None:
            started.append(cfg)
            self._job(cfg, full)

        with hydra_hands_errors_on() as full:
            try:
                main(job)()
            except (HydraException, OmegaConfBaseException) as error:
                _refuse(refusal(error), full)
            except EaipError as error:
                _refuse(of_a_sweep(error), full)
            except KeyboardInterrupt:
                print(INTERRUPTED, file=sys.stderr)
                sys.exit(EXIT_INTERRUPTED)
            except (OSError, RuntimeError) as error:
                if (explained := of_a_cluster(error)) is not None:
                    _refuse(explained, full)
                if started or not isinstance(error, OSError):
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

        from eaip_prob import plugins

        plugins.register()
        inside_a_run = GlobalHydra.instance().is_initialized()
        folder = str(self.conf.resolve())
        with contextlib.nullcontext() if inside_a_run else initialize_config_dir(folder, version_base="1.3"):
            return compose(self.name, overrides or [])

    def execute(self, cfg: DictConfig, folder: Path, overrides: Sequence[str] = ()) -> dict[str, float] | None:
        """Runs into a folder, as the command line does.

        Args:
            cfg: the configuration, without Hydra's own node.
            folder: made if it is absent.
            overrides: what was typed to get `cfg`, written down beside the results.

        Returns:
            the flat metrics, or None where the folder holds a finished run of the same configuration.

        Raises:
            InputError: the folder belongs to a run of another configuration, or a metric is not a finite number.
            MissingDataError: recorded data are absent.
            StorageError: the disk is full.
        """
        config = _resolved(cfg)
        check_kinds(cfg, self.compose())
        results = RunFolder(folder)
        if not self.repeatable and results.is_finished(config):
            return None
        environment = {"experiment": self.name, "overrides": sorted(overrides), **description(cfg.get("seed"))}
        with _storage(folder):
            results.start(config, environment)
            try:
                with torch_threads(_num_threads(cfg)):
                    metrics = flat_metrics(self.unwrapped(cfg, folder))
                results.finish(metrics)
            except Exception as error:
                results.fail(error)
                if self.repeatable and isinstance(error, EaipError):
                    results.discard()
                raise
        return metrics

    def _job(self, cfg: DictConfig, full: bool) -> None:
        from hydra.core.hydra_config import HydraConfig
        from hydra.types import RunMode

        hydra = HydraConfig.get()
        folder = Path(hydra.runtime.output_dir)
        typed = [override for override in hydra.overrides.task if not override.startswith("run_dir=")]
        try:
            # Read when torch is imported, which is yet to come.
            os.environ["OMP_NUM_THREADS"] = str(_num_threads(cfg))
            metrics = self.execute(cfg, folder, typed)
        except MissingDataError as error:
            print(error)
            return
        except EaipError as error:
            if hydra.mode != RunMode.MULTIRUN:
                _refuse(error, full)
            print(f"{folder.name}: {error}", file=sys.stderr)
            raise
        else:
            note = "" if metrics is not None else " (finished before, left as it is; choose another run_dir to repeat)"
            print(f"Results are in {os.path.relpath(folder)}{note}.")


def experiment(name: str, conf: Path | None = None, repeatable: bool = False) -> Callable[[Body], Experiment]:
    """Decorator that makes a function (cfg, folder) -> metrics an experiment with a command line.

    Args:
        name: its primary config, without `.yaml`.
        conf: folder of configuration files; default the package's own.
        repeatable: see `Experiment`.

    Example:
        >>> @experiment("base")
        ... def run(cfg, folder):
        ...     return {"error": {"rmse": 0.5}}
        >>> run.compose(["seed=3"]).seed
        3
    """

    def decorate(body: Body) -> Experiment:
        return Experiment(name, body, conf or conf_dir(), repeatable)

    return decorate


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


@contextlib.contextmanager
def _storage(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        raise StorageError(
            f"Expected room for results in {folder.name!r}, got: {error.strerror}. Make room, or choose another "
            "run_dir, and start the same command again; finished runs are kept."
        ) from error


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


def _num_threads(cfg: DictConfig) -> int:
    count = cfg.get("threads", 1)
    if not isinstance(count, int) or count < 1:
        raise InputError(f"Expected threads as an integer of at least 1, got {count!r}.")
    return count


def _refuse(error: EaipError, full: bool) -> None:
    if full:
        traceback.print_exception(error)
    print(error, file=sys.stderr)
    sys.exit(EXIT_INPUT)
