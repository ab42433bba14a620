from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from eaip_prob.errors import DataFileError, InputError
from eaip_prob.parts import Part, completed

KILLED = """
import os, signal, sys
from pathlib import Path
from eaip_prob.parts import Part, completed

def compute(part):
    with open("computed.txt", "a") as log:
        print(part.name, file=log)
    if part.config["number"] == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)
    return {"third": part.config["number"] / 3}

parts = [Part(f"part-{number}", {"number": number}) for number in range(5)]
for name, metrics in completed(Path("run"), parts, compute):
    print(name, repr(metrics["third"]))
"""


def parts_of(*numbers: int, seed: int = 0) -> list[Part]:
    return [Part(f"part-{number}", {"number": number, "seed": seed}) for number in numbers]


class Counting:
    def __init__(self) -> None:
        self.computed: list[str] = []

    def __call__(self, part: Part) -> dict[str, dict[str, float]]:
        self.computed.append(part.name)
        if part.config["number"] == 13:
            raise ValueError("unlucky")
        return {"a": {"third": part.config["number"] / 3}}


def test_an_error_stops_the_run_and_what_was_finished_is_kept(tmp_path: Path) -> None:
    first, second = Counting(), Counting()
    with pytest.raises(ValueError, match="unlucky"):
        dict(completed(tmp_path, parts_of(1, 2, 13, 4), first))
    assert first.computed == ["part-1", "part-2", "part-13"]
    results = dict(completed(tmp_path, parts_of(1, 4, 2), second))
    assert second.computed == ["part-4"]
    assert results == {f"part-{number}": {"a/third": number / 3} for number in (1, 4, 2)}
    assert list(results) == ["part-1", "part-4", "part-2"]


def test_a_killed_process_goes_on_where_it_stopped(tmp_path: Path) -> None:
    def run(victim: int) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", KILLED, str(victim)]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=os.environ)

    assert run(3).returncode < 0
    left = {path.name for path in (tmp_path / "run" / "parts").iterdir()}
    assert left == {f"part-{number}.json" for number in range(3)}
    done = run(-1)
    assert done.stdout.split("\n")[:5] == [f"part-{number} {number / 3!r}" for number in range(5)]
    computed = (tmp_path / "computed.txt").read_text().split()
    assert computed == ["part-0", "part-1", "part-2", "part-3", "part-3", "part-4"]


def test_another_configuration_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    dict(completed(tmp_path, parts_of(2), Counting()))
    before = (tmp_path / "parts" / "part-2.json").read_bytes()
    again = Counting()
    with pytest.raises(InputError, match=r"parts/part-2.json to be a result of this configuration.*run_dir"):
        dict(completed(tmp_path, parts_of(1, 2, seed=1), again))
    assert again.computed == [] and (tmp_path / "parts" / "part-2.json").read_bytes() == before


def test_the_order_of_keys_is_no_other_configuration(tmp_path: Path) -> None:
    one, other = {"a": 1, "b": {"c": [2.5], "d": None}}, {"b": {"d": None, "c": [2.5]}, "a": 1}
    assert Part("x", one).fingerprint == Part("x", other).fingerprint
    changed = [{"a": 2, "b": one["b"]}, {"a": 1, "b": {"c": [2.5, 3], "d": None}}, {"a": 1}]
    assert len({Part("x", config).fingerprint for config in [one, *changed]}) == 4


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"fingerprint": "a"}', '{"fingerprint": "a", "metrics": 3}'])
def test_a_damaged_file_is_named(text: str, tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "part-1.json").write_text(text)
    with pytest.raises(DataFileError, match=r"parts/part-1.json.*damaged.*Delete it"):
        dict(completed(tmp_path, parts_of(1), Counting()))


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"different names, got \['part-1'\]"):
        next(completed(tmp_path, parts_of(1, 2, 1), Counting()))
    for name in ("", "a/b", "../x", ".hidden", "a b"):
        with pytest.raises(InputError, match="name of a part"):
            Part(name, {})
    for config in ({"x": float("nan")}, {"x": object()}):
        with pytest.raises(InputError, match="part 'x' as plain finite values"):
            Part("x", config)
    with pytest.raises(InputError, match="one finite number as metric 'a'"):
        dict(completed(tmp_path, parts_of(1), lambda part: {"a": float("nan")}))
    assert not list((tmp_path / "parts").iterdir())


def test_the_file_says_what_it_is_of(tmp_path: Path) -> None:
    dict(completed(tmp_path, parts_of(2), Counting()))
    entry = json.loads((tmp_path / "parts" / "part-2.json").read_text())
    assert entry["config"] == {"number": 2, "seed": 0} and entry["metrics"] == {"a/third": 2 / 3}
