from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from eaip_prob.data import load, read_reach_to_grasp, time_normalised
from eaip_prob.errors import DataFileError, InputError, MissingDataError

FOLDER = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
JOINTS = ["Neck", "RElbow", "RWrist", "RThumb4FingerTip", "RIndex4FingerTip"]
LENGTHS = [4, 6, 3]


def arrays():
    rng = np.random.default_rng(5)
    rows = sum(LENGTHS)
    xy = rng.uniform(20, 200, (rows, 5, 2)).astype(np.float32)
    prob = rng.uniform(0.1, 1.0, (rows, 5)).astype(np.float32)
    prob[1, 1] = prob[5, 3] = prob[7, 4] = 0.0
    xy[1, 1] = xy[5, 3] = 0.0
    time = np.concatenate([-0.3 + 0.0166 * np.arange(length) for length in LENGTHS]).astype(np.float32)
    return {
        "xy": xy,
        "prob": prob,
        "time": time,
        "offsets": np.cumsum([0, *LENGTHS]),
        "participant": np.array([4, 4, 9]),
        "cube_edge_cm": np.array([2.5, 5.5, 7.5], dtype=np.float32),
        "joints": np.array(JOINTS),
    }


def write(folder, **changes):
    content = arrays() | changes
    np.savez(folder / "reach_cube_train.npz", **{k: v for k, v in content.items() if v is not None})
    return folder


def test_limb_and_aperture(tmp_path):
    raw = arrays()
    reaches = read_reach_to_grasp(write(tmp_path))
    assert reaches.groups == (4, 4, 9)
    assert [d.human.num_samples for d in reaches] == LENGTHS
    assert reaches[0].human.names == ("RElbow x", "RElbow y", "RWrist x", "RWrist y")
    assert reaches[0].robot.names == ("aperture",)
    assert reaches.environments.names == ("cube_edge",)
    assert reaches.environments.value.flatten().tolist() == [0.025, 0.055, 0.075]
    second = reaches[1]
    np.testing.assert_array_equal(second.human.time, raw["time"][4:10].astype(float))
    np.testing.assert_array_equal(second.human.values[:, 2], raw["xy"][4:10, 2, 0].astype(float))
    np.testing.assert_array_equal(second.human.values[:, 1], raw["xy"][4:10, 1, 1].astype(float))
    tips = raw["xy"][4:10].astype(float)
    expected = np.sqrt(((tips[:, 3] - tips[:, 4]) ** 2).sum(-1))
    seen = [True, False, True, False, True, True]
    assert second.robot.mask[:, 0].tolist() == seen
    np.testing.assert_allclose(second.robot.values[seen, 0], expected[seen])
    assert reaches[0].human.mask[1].tolist() == [False, False, True, True]
    assert reaches[0].human.mask.sum() == 14


def test_tips_and_other_joints(tmp_path):
    raw = arrays()
    reaches = read_reach_to_grasp(write(tmp_path), human=["Neck"], robot="tips")
    assert reaches[2].human.names == ("Neck x", "Neck y")
    tip = "RThumb4FingerTip", "RIndex4FingerTip"
    assert reaches[2].robot.names == tuple(f"{joint} {axis}" for joint in tip for axis in "xy")
    np.testing.assert_array_equal(reaches[2].robot.values, raw["xy"][10:, 3:5].reshape(3, 4).astype(float))
    assert reaches[1].robot.mask[1].tolist() == [False, False, True, True]


def test_missing_data_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    message = (
        "Expected the file reach_cube_train.npz in ../shared/data, got no such file; set data_dir to the folder that "
        "holds it."
    )
    with pytest.raises(MissingDataError) as caught:
        read_reach_to_grasp("../shared/data")
    assert str(caught.value) == message
    with pytest.raises(MissingDataError, match="got none; set data_dir to"):
        read_reach_to_grasp(None)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"prob": None}, r"Expected arrays \['prob'\]"),
        ({"xy": np.zeros((13, 5))}, "array 'xy' in .* with 3 axes"),
        ({"xy": np.zeros((13, 4, 2))}, r"array 'xy' in .* with shape \(13, 5, 2\), got \(13, 4, 2\)"),
        ({"prob": np.zeros((12, 5))}, r"array 'prob' in .* with shape \(13, 5\)"),
        ({"cube_edge_cm": np.zeros(2)}, r"array 'cube_edge_cm' in .* with shape \(3,\)"),
        ({"offsets": np.array([0, 4, 10, 12])}, "rising from 0 to its 13 rows"),
        ({"offsets": np.array([0, 4, 4, 13])}, "usable motion number 1 in .*at least one sample"),
        ({"time": np.zeros(13)}, "usable motion number 0 in .*strictly increasing"),
        ({"joints": np.array(JOINTS, dtype=object)}, "Pickled objects are never loaded"),
    ],
)
def test_damage(tmp_path, changes, message):
    with pytest.raises(DataFileError, match=message):
        read_reach_to_grasp(write(tmp_path, **changes))


def test_repeated_time_is_refused_with_the_motion(tmp_path):
    time = arrays()["time"]
    time[6] = time[5]
    with pytest.raises(DataFileError, match="motion number 1 .*a step of 0 s after sample"):
        read_reach_to_grasp(write(tmp_path, time=time))


def test_not_an_npz(tmp_path):
    (tmp_path / "reach_cube_train.npz").write_bytes(b"x" * 99)
    with pytest.raises(DataFileError, match=r"complete \.npz file"):
        read_reach_to_grasp(tmp_path)


def test_bad_questions(tmp_path):
    write(tmp_path)
    with pytest.raises(InputError, match=r"joints among \['Neck', .*got \('LWrist',\)"):
        read_reach_to_grasp(tmp_path, human=("LWrist",))
    with pytest.raises(InputError, match="joints among"):
        read_reach_to_grasp(tmp_path, human="Neck")
    with pytest.raises(InputError, match="joints among"):
        read_reach_to_grasp(tmp_path, human=())
    with pytest.raises(InputError, match="robot as 'aperture' or 'tips', got 'hand'"):
        read_reach_to_grasp(tmp_path, robot="hand")


@pytest.mark.skipif(not (FOLDER / "reach_cube_train.npz").is_file(), reason="recorded reaches are not here")
def test_recorded_reaches(tmp_path):
    reaches = read_reach_to_grasp(FOLDER)
    assert len(reaches) == 536
    assert sorted(set(reaches.groups)) == [1, 3, 4, 5, 7, 8]
    assert set(reaches.environments.value.flatten().tolist()) == {0.025, 0.055, 0.075}
    human, robot = reaches.trajectories("human"), reaches.trajectories("robot")
    assert 0.84 < human.duration.min() < human.duration.max() < 1.28
    assert -0.3 <= human.time[:, 0].min() <= human.time[:, 0].max() < -0.18
    assert (robot.values[robot.mask] < 50).all()
    assert [33703 - int(human.mask[..., signal].sum()) for signal in range(4)] == [2, 2, 15, 15]
    normalised = time_normalised(human, 60)
    assert normalised.mask.double().mean() > 0.999
    assert torch.equal(load(reaches.save(tmp_path / "set.npz")).trajectories("human").values, human.values)
