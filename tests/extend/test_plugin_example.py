from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "docs" / "extend" / "plugin_example"
TINY = [
    "num_train=3",
    "num_test=1",
    "num_plans=9",
    "samples_seen=[10,100]",
    "feature_errors=[0,50]",
    "feature_noises=[1,100]",
    "sample_noises=[0,3]",
    "phase=elapsed",
    "recording=none",
]
MODEL = """
from dataclasses import dataclass, replace

import torch

from eaip_prob.gaussian import BlockGaussian
from eaip_prob.models import AbstractJointModel, Posterior, WeightTable, conditioned


@dataclass(frozen=True, eq=False)
class Theirs(AbstractJointModel):
    joint: BlockGaussian | None = None

    def fit(self, weights, observed=None, groups=None, target="robot", grams=None):
        rows = WeightTable.of(weights, observed, groups, target, grams)
        centred = rows.rows - rows.rows.mean(0)
        covariance = centred.mT @ centred / len(centred)
        own = torch.diag(covariance.diagonal())
        return replace(self, joint=BlockGaussian(rows.rows.mean(0), covariance + SHARE * own, rows.layout))
"""
POSTERIOR = """
    def posterior(self, observations, log_weight=None, keep=None):
        return conditioned(self.joint, observations, log_weight, keep)
"""
NAN = """
    def posterior(self, observations, log_weight=None, keep=None):
        answer = conditioned(self.joint, observations, log_weight, keep)
        parts = answer.components
        mean = torch.full_like(parts.mean, torch.nan)
        return Posterior(BlockGaussian(mean, parts.covariance, parts.layout), answer.log_weight, answer.log_evidence)
"""
# The text of the module, and what the one sentence must say.
BROKEN = {
    "import": ("import no_such_module\n", ["predictor.model", "theirs.Theirs", "No module named 'no_such_module'"]),
    "no_class": ("", ["predictor.model", "theirs.Theirs"]),
    "no_posterior": (f"SHARE = 0.1{MODEL}", ["predictor.model", "theirs.Theirs", "posterior"]),
    "no_model": ("class Theirs:\n    pass\n", ["model", "AbstractJointModel", "got Theirs"]),
    "nan": (f"SHARE = 0.1{MODEL}{NAN}", ["finite", "mean", "nan"]),
    "indefinite": (f"SHARE = -0.1{MODEL}{POSTERIOR}", ["positive semi-definite covariance", "eigenvalue of -"]),
}


def script(site: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "experiments/passing_over.py", *overrides]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(site)}
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False, env=environment)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plugin")
    leftovers = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    shutil.copytree(EXAMPLE, folder / "source", ignore=leftovers)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    install = [*pip, "--target", str(folder / "site"), str(folder / "source")]
    done = subprocess.run(install, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "site"


@pytest.fixture
def package(tmp_path):
    def write(text: str, module: str = "theirs", option: str = "broken") -> Path:
        conf = tmp_path / module / "conf" / "model"
        conf.mkdir(parents=True)
        (tmp_path / module / "__init__.py").write_text(text)
        (conf / f"{option}.yaml").write_text(f"# @package predictor.model\n_target_: {module}.Theirs\n")
        metadata = tmp_path / f"{module}-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text(f"[eaip_prob.configs]\n{module} = {module}.conf\n")
        return tmp_path

    return write


@pytest.mark.slow
def test_the_example_is_in_the_tables_of_passing_over(site, tmp_path):
    further = ["+model@models.eaip_robust=robust", "models.eaip_robust.tail=2"]
    done = script(site, "model=robust", *further, f"run_dir={tmp_path / 'run'}", *TINY)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "| eaip " in done.stdout and "| eaip_robust " in done.stdout
    assert "_target_: eaip_prob_robust.RobustJointModel" in (tmp_path / "run" / "config.yaml").read_text()
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    for method in ("eaip", "eaip_robust"):
        assert metrics[f"rmse/both/{method}/100"] < 0.6 * metrics["rmse/both/mean/100"]
    assert metrics["rmse/both/eaip/100"] != metrics["rmse/both/eaip_robust/100"]


@pytest.mark.slow
def test_the_example_is_an_option_that_help_lists(site):
    done = script(site, "--help")
    assert done.returncode == 0 and "robust" in done.stdout
    found = script(site, "model=robust", "predictor.model.tail=2", "--cfg", "job", "--package", "predictor.model")
    assert "_target_: eaip_prob_robust.RobustJointModel" in found.stdout and "tail: 2" in found.stdout


@pytest.mark.slow
def test_the_examples_own_tests_pass(site):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(EXAMPLE)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(site)}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False, env=environment)
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.slow
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_model_is_one_sentence_that_says_what_and_where(package, tmp_path, name):
    text, said = BROKEN[name]
    done = script(package(text), "model=broken", f"run_dir={tmp_path / 'run'}", *TINY)
    assert done.returncode == 2, done.stderr[-2000:]
    assert "Traceback" not in done.stderr and len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert all(part in done.stderr for part in said), done.stderr
    assert not (tmp_path / "run" / "metrics.json").exists()


@pytest.mark.slow
def test_a_broken_package_disturbs_no_other_option(package, site):
    broken = package("raise ImportError('no such module')\n")
    for option in ("gaussian", "robust"):
        done = script(Path(f"{broken}{os.pathsep}{site}"), f"model={option}", "--cfg", "job")
        assert done.returncode == 0 and "_target_" in done.stdout, done.stderr[-2000:]
