from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from eaip_prob.data import read_handover
from eaip_prob.data.handover import speed
from eaip_prob.errors import DataFileError, InputError, MissingDataError

FOLDER = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
FPS = 100.0
FRAMES = 400


def smooth(start, stop, moment, frames, takes):
    """From start to stop in `takes` seconds from `moment` on, on a minimum-jerk curve."""
    s = np.clip((np.arange(frames) / FPS - moment) / takes, 0.0, 1.0)[:, None]
    return start + (stop - start) * (10 * s**3 - 15 * s**4 + 6 * s**5)


def hands(begin=0.8, takes=1.5, frames=FRAMES):
    """Hands that approach each other to 0.2 m and then move on together in the taker's direction."""
    giver = smooth(np.array([0.1, -0.5, 0.8]), np.array([0.4, 0.0, 1.0]), begin, frames, takes)
    taker = smooth(np.array([0.9, 0.5, 0.9]), np.array([0.6, 0.0, 1.0]), begin + 0.2, frames, takes)
    pull = smooth(np.zeros(3), np.array([0.5, 0.2, 0.0]), begin + 0.2 + takes + 0.3, frames, 1.0)
    return giver + pull, taker + pull


def arrays(noise=0.0, recordings=((0.8, 1.5), (0.5, 1.1), (1.0, 1.3))):
    rng = np.random.default_rng(2)
    pairs = np.stack([hands(*recording) for recording in recordings]).astype(float)
    pairs = pairs + noise * rng.standard_normal(pairs.shape)
    rest = rng.uniform(-1, 1, (2, len(recordings), FRAMES, 4))
    giver, taker = (np.concatenate([rest[i], pairs[:, i, :, ::-1]], axis=-1) for i in range(2))
    return {
        "giver": giver.astype(np.float32),
        "taker": taker.astype(np.float32),
        "columns": np.array(["qx", "qy", "qz", "qw", "z", "y", "x"]),
        "fps": np.array(FPS),
        "index": np.array([11, 17, 23]),
    }


def write(folder, content=None, **changes):
    content = (arrays() if content is None else content) | changes
    np.savez(folder / "kth_handover_train.npz", **{k: v for k, v in content.items() if v is not None})
    return folder


def test_cut_from_onset_to_meeting(tmp_path):
    handovers = read_handover(write(tmp_path))
    assert handovers.groups == (11, 17, 23)
    giver, taker = hands(0.8, 1.5)
    velocity = np.linalg.norm(np.gradient(giver, 1 / FPS, axis=0), axis=1)
    first = int((velocity > 0.1).argmax())
    distance = np.linalg.norm(giver - taker, axis=1)
    last = int((distance <= distance.min() + 0.02).argmax())
    motion = handovers[0]
    assert abs(motion.human.num_samples - (last - first + 1)) <= 2
    assert motion.human.names == motion.robot.names == ("x", "y", "z")
    np.testing.assert_allclose(motion.robot.values[-1], giver[last], atol=1e-6)
    np.testing.assert_allclose(motion.human.values[-1], taker[last], atol=1e-6)
    np.testing.assert_allclose(motion.human.time, np.arange(motion.human.num_samples) / FPS)
    assert motion.environment.names == ("giver_x", "giver_y", "giver_z")
    np.testing.assert_array_equal(motion.environment.value, motion.robot.values[0])
    np.testing.assert_allclose(motion.robot.values[0], giver[last - motion.robot.num_samples + 1], atol=1e-6)
    assert motion.human.mask.all()


def test_noise_at_rest_is_no_onset(tmp_path):
    """Half a millimetre at 100 Hz is 0.07 m/s between neighbours, 0.1 m/s in three axes, and no motion."""
    quiet = read_handover(write(tmp_path))
    noisy = read_handover(write(tmp_path, arrays(noise=5e-4)))
    for one, other in zip(quiet, noisy, strict=True):
        assert abs(float(one.human.duration) - float(other.human.duration)) < 0.06


def test_the_taker_may_move_first(tmp_path):
    content = arrays()
    swapped = content | {"giver": content["taker"], "taker": content["giver"]}
    one, other = read_handover(write(tmp_path, content)), read_handover(write(tmp_path, swapped))
    assert [d.human.num_samples for d in one] == [d.human.num_samples for d in other]
    np.testing.assert_array_equal(one[1].human.values, other[1].robot.values)


def test_hands_that_move_from_the_first_frame(tmp_path):
    content = arrays(recordings=((-0.5, 1.5), (0.5, 1.1), (1.0, 1.3)))
    motion = read_handover(write(tmp_path, content))[0]
    np.testing.assert_allclose(motion.robot.values[0], hands(-0.5, 1.5)[0][0], atol=1e-6)


def test_recordings_left_out_are_named(tmp_path):
    content = arrays()
    content["giver"][1] = content["giver"][1, :1]
    content["taker"][1] = content["taker"][1, :1]
    with pytest.warns(UserWarning, match=r"Left out recordings \[17\] of .*2 are kept"):
        handovers = read_handover(write(tmp_path, content))
    assert handovers.groups == (11, 23)


def test_a_meeting_before_the_onset_is_left_out(tmp_path):
    content = arrays()
    content["giver"][2] = content["giver"][2, ::-1]
    content["taker"][2] = content["taker"][2, :1]
    content["taker"][2, :, 4:] = content["giver"][2, :1, 4:]
    with pytest.warns(UserWarning, match=r"\[23\]"):
        assert len(read_handover(write(tmp_path, content))) == 2


def test_speed_of_a_line_and_of_a_curve():
    time = np.arange(50) / 30.0
    line = np.stack([0.3 * time, -0.4 * time + 2.0], axis=-1)
    np.testing.assert_allclose(speed(line, 7, 30.0), 0.5)
    curve = np.stack([time**2, 0 * time], axis=-1)
    slopes = [abs(np.polyfit(time[i - 3 : i + 4], curve[i - 3 : i + 4, 0], 1)[0]) for i in range(3, 47)]
    np.testing.assert_allclose(speed(curve, 7, 30.0)[3:-3], slopes)
    np.testing.assert_allclose(speed(np.stack([line, curve]), 7, 30.0)[1], speed(curve, 7, 30.0))


def test_missing_data_is_one_sentence():
    with pytest.raises(MissingDataError) as caught:
        read_handover("some/where")
    assert str(caught.value) == (
        "Expected the file kth_handover_train.npz in some/where, got no such file; set data_dir to the folder that "
        "holds it."
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"taker": None}, r"Expected arrays \['taker'\]"),
        ({"columns": np.array(list("abcdefg"))}, r"Expected columns \('x', 'y', 'z'\) in"),
        ({"columns": np.array(list("xyz"))}, "one name per column of 'giver'"),
        ({"fps": np.array(0.0)}, "fps above zero in .*, got 0.0"),
        ({"fps": np.array([60.0])}, "array 'fps' in"),
        ({"index": np.arange(2)}, "alike for 2 recordings"),
        ({"taker": np.zeros((3, 399, 7))}, r"got \(3, 400\) and \(3, 399\)"),
        ({"giver": np.zeros((3, 9, 7)), "taker": np.zeros((3, 9, 7))}, "at least 21 frames"),
        ({"giver": np.full((3, 400, 7), np.nan)}, "finite positions of 'giver' in .* recording 11"),
        ({"giver": np.zeros((3, 400, 7)), "taker": np.ones((3, 400, 7))}, "move before the hands meet in .*got none"),
    ],
)
def test_damage(tmp_path, changes, message):
    with pytest.raises(DataFileError, match=message):
        read_handover(write(tmp_path, **changes))


def test_bad_questions(tmp_path):
    with pytest.raises(InputError, match="onset_speed above zero"):
        read_handover(write(tmp_path), onset_speed=0.0)


@pytest.mark.skipif(not (FOLDER / "kth_handover_train.npz").is_file(), reason="recorded hand-overs are not here")
def test_recorded_handovers():
    handovers = read_handover(FOLDER)
    assert len(handovers) == 95
    assert len(set(handovers.groups)) == 95
    duration = handovers.trajectories("human").duration
    assert 1.0 < duration.min() < duration.median() < duration.max() < 3.3
    human, robot = handovers.trajectories("human"), handovers.trajectories("robot")
    assert human.time.ndim == 1
    for motion in handovers:
        distance = np.linalg.norm(motion.human.values - motion.robot.values, axis=-1)
        assert distance[-1] < 0.28
        assert distance[-1] == distance.min()
    assert robot.values.abs().max() < 2.0
