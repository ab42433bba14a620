from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import torch

from eaip_prob.data import Demonstration, DemonstrationSet, EnvironmentFeatures, Trajectory, load, save
from eaip_prob.errors import DataFileError, EaipError, InputError, MissingDataError

NAMES = ("elbow x", "Ellbogen \u00fc", "nul\x00")


def motion(number, names, noise, seed):
    generator = torch.Generator().manual_seed(100 * seed + number)
    size, length = len(names), 3 + number
    values = torch.randn(length, size, generator=generator, dtype=torch.float64) * 30 + 100
    mask = torch.rand(length, size, generator=generator) > 0.3
    root = torch.randn(length, size, size, generator=generator, dtype=torch.float64)
    time = (0.05 + torch.rand(length, generator=generator, dtype=torch.float64)).cumsum(0) - 0.7
    return Trajectory(time, values, names, mask, root @ root.mT if noise else None)


def environment(number):
    generator = torch.Generator().manual_seed(number)
    root = torch.randn(2, 2, generator=generator, dtype=torch.float64)
    observed = torch.tensor([number % 2 == 0, True])
    return EnvironmentFeatures(("w", "h"), [3.0 + number, -1.0], root @ root.mT, observed)


def make(agents=("human", "robot"), scene=True, noise="some", groups=(1, "1", 1, "b", -7)):
    demonstrations = []
    for number in range(5):
        noisy = noise == "all" or (noise == "some" and number % 2 == 1)
        parts = {"human": motion(number, NAMES, noisy, 1), "robot": motion(2 * number, ("grip",), False, 2)}
        kept = {agent: parts[agent] for agent in agents}
        demonstrations.append(Demonstration(**kept, environment=environment(number) if scene else None))
    return DemonstrationSet(demonstrations, groups)


def assert_same(one, other):
    assert one.groups == other.groups
    assert [type(group) for group in one.groups] == [type(group) for group in other.groups]
    assert one.agents == other.agents
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        for agent in one.agents:
            x, y = getattr(a, agent), getattr(b, agent)
            assert x.names == y.names
            for part in ("time", "values", "mask"):
                assert torch.equal(getattr(x, part), getattr(y, part))
            assert (x.noise is None) == (y.noise is None)
            assert x.noise is None or torch.equal(x.noise, y.noise)
        assert (a.environment is None) == (b.environment is None)
        if a.environment is not None:
            assert a.environment.names == b.environment.names
            for part in ("value", "covariance", "observed"):
                assert torch.equal(getattr(a.environment, part), getattr(b.environment, part))


@pytest.mark.parametrize("agents", [("human",), ("robot",), ("human", "robot")])
@pytest.mark.parametrize("scene", [True, False])
@pytest.mark.parametrize("noise", ["all", "some", "none"])
def test_round_trip(tmp_path, agents, scene, noise):
    demonstrations = make(agents, scene, noise)
    path = save(demonstrations, str(tmp_path / "new" / "set.npz"))
    assert path == tmp_path / "new" / "set.npz"
    assert_same(load(path), demonstrations)
    assert_same(demonstrations, make(agents, scene, noise))
    assert [file.name for file in path.parent.iterdir()] == ["set.npz"]


@pytest.mark.slow
def test_round_trip_in_a_fresh_process(tmp_path):
    path = make().save(tmp_path / "set.npz")
    code = (
        "import sys; from eaip_prob.data import load, save;"
        "save(load(sys.argv[1]), sys.argv[2])"
    )  # fmt: skip
    subprocess.run([sys.executable, "-c", code, path, tmp_path / "again.npz"], check=True)
    assert_same(DemonstrationSet.load(tmp_path / "again.npz"), make())
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


def test_numpy_integers_are_groups_and_others_are_refused(tmp_path):
    path = save(make(groups=list(np.arange(5))), tmp_path / "set.npz")
    assert load(path).groups == (0, 1, 2, 3, 4)
    with pytest.raises(InputError, match=r"groups as integers or strings, got 1\.5 of type float"):
        save(make(groups=[1, 2, 1.5, 3, 4]), tmp_path / "other.npz")


def test_features_are_saved_in_the_order_of_the_first(tmp_path):
    second = Demonstration(human=motion(1, NAMES, False, 1), environment=environment(1).ordered_as(("h", "w")))
    first = Demonstration(human=motion(0, NAMES, False, 1), environment=environment(0))
    loaded = load(save(DemonstrationSet([first, second]), tmp_path / "set.npz"))
    assert loaded[1].environment.names == ("w", "h")
    assert torch.equal(loaded[1].environment.covariance, environment(1).covariance)


def test_bytes_hold_no_date(tmp_path):
    path = save(make(), tmp_path / "set.npz")
    with zipfile.ZipFile(path) as archive:
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


@pytest.mark.parametrize("failing", ["fsync", "replace"])
def test_failed_writing_keeps_what_was_there(tmp_path, monkeypatch, failing):
    path = save(make(), tmp_path / "set.npz")
    before = path.read_bytes()

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, failing, fail)
    with pytest.raises(OSError, match="disk full"):
        save(make(noise="all"), path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["set.npz"]


def test_missing_file(tmp_path):
    with pytest.raises(MissingDataError, match="got no such file"):
        load(tmp_path / "none.npz")
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.npz")


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04", b"\x93NUMPY\x01\x00"])
def test_other_kinds_of_file(tmp_path, content):
    path = tmp_path / "set.npz"
    path.write_bytes(content)
    with pytest.raises(DataFileError, match=r"complete \.npz file at .*Copy or make it again"):
        load(path)


def test_folder_and_single_array(tmp_path):
    with pytest.raises(DataFileError, match=r"complete \.npz file"):
        load(tmp_path)
    np.save(tmp_path / "one.npy", np.arange(3))
    with pytest.raises(DataFileError, match=r"complete \.npz file"):
        load(tmp_path / "one.npy")


def test_truncated_anywhere(tmp_path):
    path = save(make(), tmp_path / "set.npz")
    whole = path.read_bytes()
    for length in range(0, len(whole), max(len(whole) // 40, 1)):
        path.write_bytes(whole[:length])
        with pytest.raises(DataFileError):
            load(path)


def test_flipped_bytes_never_load_wrong(tmp_path):
    demonstrations = make()
    path = save(demonstrations, tmp_path / "set.npz")
    whole = path.read_bytes()
    refused = 0
    for at in range(0, len(whole), 61):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :])
        try:
            assert_same(load(path), demonstrations)
        except EaipError:
            refused += 1
    assert refused > 50


def changed(tmp_path, **changes):
    """A saved set with arrays replaced (a dot is written as __), or removed where None is given."""
    path = save(make(noise="all"), tmp_path / "set.npz")
    with np.load(path) as file:
        arrays = dict(file)
    for name, change in changes.items():
        key = name.replace("__", ".")
        value = change(arrays.pop(key))
        if value is not None:
            arrays[key] = value
    np.savez(path, **arrays)
    return path


def header(**changes):
    def change(array):
        return np.array(json.dumps(json.loads(str(array)) | changes))

    return change


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"header": lambda _: None}, r"Expected arrays \['header'\]"),
        ({"human__mask": lambda _: None}, r"Expected arrays \['human.mask'\] in .*, got only \["),
        ({"environment__value": lambda _: None}, r"Expected arrays \['environment.value'\]"),
        ({"header": lambda _: np.array("not json")}, "a JSON header in"),
        ({"header": lambda _: np.array(3)}, "array 'header' in"),
        ({"header": header(format="other")}, r"the format 'eaip_prob.demonstrations' in the header"),
        ({"header": header(version=2)}, r"version 1 of the format .*got 2\. Read it with the version"),
        ({"header": header(groups=[1.5] * 5)}, "signals, features and groups in the header"),
        ({"header": header(signals={"cat": ["x"]})}, "signals, features and groups in the header"),
        ({"header": header(signals={})}, "human or a robot"),
        ({"header": header(groups=[])}, r"Expected 1 offsets of human.time"),
        (
            {"header": header(groups=[1, 2, 3, 4])},
            r"Expected 5 offsets of human.time rising from 0 to its 25 rows, got 6",
        ),
        ({"header": header(features=["only"])}, "2 different names"),
        ({"human__offsets": lambda a: a + 1}, r"rising from 0 to its 25 rows, got 6 from \[1\] to \[26\]"),
        ({"human__offsets": lambda a: a[[0, 2, 1, 3, 4, 5]]}, "rising from 0"),
        ({"human__offsets": lambda a: a[:0]}, r"got 0 from \[\] to \[\]"),
        ({"human__offsets": lambda a: a.astype(float)}, "array 'human.offsets' in"),
        ({"human__time": lambda a: a[:-1]}, "offsets of human.time"),
        ({"human__time": lambda a: 0 * a}, "strictly increasing time"),
        ({"human__values": lambda a: a * np.nan}, "finite numbers in values"),
        ({"human__values": lambda a: a.astype(str)}, "dtype of kind 'fiu'"),
        ({"human__mask": lambda a: a.astype(np.int8)}, "array 'human.mask' in"),
        ({"human__noise": lambda a: a[1:]}, "offsets of human.noise"),
        ({"human__has_noise": lambda a: ~a}, "offsets of human.noise"),
        ({"human__has_noise": lambda a: a[1:]}, "5 entries in human.has_noise, got 4"),
        ({"robot__values": lambda a: np.repeat(a, 2, axis=1)}, "mask with the shape of values"),
        ({"environment__value": lambda a: a[1:]}, "environments for 5 demonstrations, got 4"),
        ({"environment__covariance": lambda a: a[:, :1]}, "covariance with shape"),
    ],
)
def test_arrays_that_do_not_fit(tmp_path, changes, message):
    with pytest.raises(DataFileError, match=message):
        load(changed(tmp_path, **changes))


@pytest.mark.parametrize("name", ["human__time", "header", "environment__value"])
def test_pickled_objects_are_never_loaded(tmp_path, name):
    path = changed(tmp_path, **{name: lambda a: np.array([{"a": 1}], dtype=object)})
    with pytest.raises(DataFileError, match="Pickled objects are never loaded"):
        load(path)


def test_an_array_header_that_lies_about_its_size(tmp_path):
    path = changed(tmp_path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["human.time.npy"] = members["human.time.npy"].replace(b"(25,)", b"(99,)")
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    with pytest.raises(DataFileError, match="got 'human.time.npy' that is none"):
        load(path)
