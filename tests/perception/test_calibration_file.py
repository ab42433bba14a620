from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest
from camera_rig import CAMERAS, COLOR

from eaip_prob.errors import DataFileError, InputError, MissingDataError, ShapeError
from eaip_prob.perception.calibration_file import load_extrinsics, save_extrinsics
from eaip_prob.perception.extrinsics import Extrinsics


def some():
    rng = np.random.default_rng(1)
    result = {}
    for index, (name, pose) in enumerate(CAMERAS.items()):
        root = rng.normal(0.0, 1e-3, (6, 6))
        lens = replace(COLOR, fx=1060.0 + index / 3.0, distortion=(0.05 / (index + 3.0), -0.07, 0.0, 1e-4, 0.0))
        result[name] = Extrinsics(
            pose, root @ root.T, residual=0.1 + index / 3.0, num_boards=20 + index, intrinsics=lens
        )
    return result


def test_poses_come_back_to_the_last_digit(tmp_path):
    before = some()
    path = save_extrinsics(tmp_path / "new" / "kinects.json", before)
    for name, one in load_extrinsics(path).items():
        np.testing.assert_array_equal(one.T_world_camera, before[name].T_world_camera)
        np.testing.assert_array_equal(one.covariance, before[name].covariance)
        assert one.intrinsics == before[name].intrinsics
        assert (one.residual, one.num_boards) == (before[name].residual, before[name].num_boards)
    assert [file.name for file in path.parent.iterdir()] == ["kinects.json"]


@pytest.mark.slow
def test_another_process_reads_the_same(tmp_path):
    path = save_extrinsics(tmp_path / "kinects.json", some())
    code = (
        "import sys; from eaip_prob.perception.calibration_file import load_extrinsics;"
        "sys.stdout.write(repr(float(load_extrinsics(sys.argv[1])['left'].T_world_camera[0, 0])))"
    )
    told = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert float(told.stdout) == some()["left"].T_world_camera[0, 0]


@pytest.mark.parametrize("place", [0.2, 0.5, 0.9])
def test_a_changed_digit_is_refused(tmp_path, place):
    path = save_extrinsics(tmp_path / "kinects.json", some())
    text = path.read_text()
    at = next(i for i in range(int(place * len(text)), len(text)) if text[i] in "12345678")
    path.write_text(text[:at] + str(int(text[at]) + 1) + text[at + 1 :])
    with pytest.raises(DataFileError, match="kinects.json, got"):
        load_extrinsics(path)


def lens(**changes):
    return asdict(COLOR) | changes


def changed(content, **changes):
    content = json.loads(json.dumps(content))
    del content["checksum"]
    content["cameras"]["left"].update(changes)
    return content


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: text[: len(text) // 2], "no JSON"),
        (lambda text: "", "no JSON"),
        (lambda text: "[" * 100_000, "no JSON"),
        (lambda text: "[]", "another kind"),
        (lambda text: text.replace('"version": 2', '"version": 3'), "another version, 3"),
        (lambda text: text.replace('"version": 2', '"version": 1'), "version 1, which lacks the lens"),
        (lambda text: text.replace("left", "lost"), "check sum"),
        (lambda text: json.dumps({**changed(json.loads(text)), "cameras": {}}), "no cameras"),
        (lambda text: json.dumps(changed(json.loads(text), extra=1)), "without exactly"),
        (lambda text: json.dumps(changed(json.loads(text), T_world_camera=[[1.0]])), "T_world_camera with shape"),
        (lambda text: json.dumps(changed(json.loads(text), T_world_camera=np.diag([1, 1, -1, 1]).tolist())), "mirrors"),
        (lambda text: json.dumps(changed(json.loads(text), covariance=(-np.eye(6)).tolist())), "negative variance"),
        (lambda text: json.dumps(changed(json.loads(text), residual=float("nan"))), "residual"),
        (lambda text: json.dumps(changed(json.loads(text), residual=None)), "camera 'left'"),
        (lambda text: json.dumps(changed(json.loads(text), intrinsics={"fx": 1.0})), "camera 'left'"),
        (lambda text: json.dumps(changed(json.loads(text), intrinsics=lens(fx=-1.0))), "focal lengths above zero"),
        (lambda text: json.dumps(changed(json.loads(text), intrinsics=lens(distortion=None))), "camera 'left'"),
        (lambda text: json.dumps(changed(json.loads(text), num_boards=float("inf"))), "camera 'left'"),
    ],
)
def test_damaged_files_are_refused(tmp_path, damage, message):
    path = save_extrinsics(tmp_path / "kinects.json", some())
    path.write_text(damage(path.read_text()))
    with pytest.raises(DataFileError, match=message):
        load_extrinsics(path)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "kinects.json").write_bytes(b"\xff\xfe\x00kinects")
    with pytest.raises(DataFileError, match="no JSON"):
        load_extrinsics(tmp_path / "kinects.json")


def test_a_file_by_hand_needs_no_check_sum(tmp_path):
    path = save_extrinsics(tmp_path / "kinects.json", some())
    path.write_text(json.dumps(changed(json.loads(path.read_text()), num_boards=1)))
    assert load_extrinsics(path)["left"].num_boards == 1


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = save_extrinsics(tmp_path / "kinects.json", some())
    before = path.read_bytes()

    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="no space"):
        save_extrinsics(path, {"left": some()["left"]})
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1


def test_what_cannot_be_written_or_read_is_refused(tmp_path):
    with pytest.raises(InputError, match="at least one camera"):
        save_extrinsics(tmp_path / "kinects.json", {})
    with pytest.raises(InputError, match="a folder"):
        save_extrinsics(tmp_path, some())
    with pytest.raises(MissingDataError, match="Calibrate first"):
        load_extrinsics(tmp_path / "nowhere.json")


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"T_world_camera": 1.1 * np.eye(4)}, InputError, "T_world_camera"),
        ({"covariance": np.eye(3)}, ShapeError, "covariance"),
        ({"covariance": np.full((6, 6), np.nan)}, InputError, "finite"),
        ({"residual": -0.1}, InputError, "residual"),
        ({"num_boards": 0}, InputError, "0 boards"),
    ],
)
def test_bad_extrinsics_are_refused(changes, error, message):
    given = {"T_world_camera": np.eye(4), "covariance": np.eye(6), "residual": 0.1, "num_boards": 3} | changes
    given["intrinsics"] = COLOR
    with pytest.raises(error, match=message):
        Extrinsics(**given)
