from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from covering_world import case, shared

from eaip_prob.errors import InputError
from eaip_prob.robot import baxter_left_arm
from eaip_prob.tasks.bag_covering.faults import Faults
from eaip_prob.tasks.bag_covering.judging import Judge
from eaip_prob.tasks.bag_covering.outcome import KINDS, SCORES, Run, ended
from eaip_prob.tasks.bag_covering.running import Job, all_performed, performed, read_result, write_result
from eaip_prob.tasks.bag_covering.trial import Looks, Trial

# People who stop or are slow are watched for longer than any demonstration took.
ignored = pytest.mark.filterwarnings("ignore::eaip_prob.errors.ExtrapolationWarning")
pytestmark = [pytest.mark.slow, ignored]


def run(faults: Faults | None = None, method: str = "eaip", name: str = "brown_bookshelf", **changed) -> Run:
    setting, one = dataclasses.replace(shared(), **changed), case(name)
    trial = Trial(one.site, one.motion, setting.perception, one.seed, setting.looks, faults or Faults(), bag=None)
    return ended(trial.steps(setting.loop(method)), Judge(one.site, baxter_left_arm()))


@pytest.mark.parametrize(
    "faults",
    [
        Faults(stop=4.0),
        Faults(back=4.0),
        Faults(leave=4.0),
        Faults(leave=0.0),
        Faults(unseen=True),
        Faults(wrong_class="chair"),
        Faults(hidden=(2.0, 5.0)),
        Faults(delay=0.6),
        Faults(speed=2.0),
        Faults(speed=0.5),
    ],
    ids=["stops", "back", "leaves", "absent", "unseen", "wrong_class", "hidden", "late", "fast", "slow"],
)
def test_whatever_goes_wrong_ends_in_a_stated_outcome(faults):
    result = run(faults)
    assert result.kind in KINDS and result.reason.endswith(".")
    steps = np.linalg.norm(np.diff(result.gripper, axis=0), axis=-1) * 30.0
    assert steps.max() < 1.1  # m/s


def test_without_an_object_the_robot_holds_and_says_why():
    result = run(Faults(unseen=True))
    assert result.kind == "held" and "No object" in result.reason
    assert np.ptp(result.gripper, axis=0).max() == 0.0


def test_a_partner_who_leaves_or_goes_back_ends_it():
    assert run(Faults(leave=4.0)).kind in ("aborted", "held")
    assert "back" in run(Faults(back=4.0)).reason


def test_the_robot_waits_while_it_observes():
    result = run(method="ip")
    early = result.gripper[result.time <= 1.0]
    np.testing.assert_array_equal(early, np.tile(early[0], (len(early), 1)))
    assert np.ptp(result.gripper[:, 1]) > 0.1


def test_a_run_of_one_seed_is_the_same_again():
    first, second = run(), run()
    np.testing.assert_array_equal(first.gripper, second.gripper)


def test_looks_are_frequent_at_first():
    looks = Looks(rate=30.0, later_rate=5.0, change=1.5)
    due = [step for step in range(90) if looks.due(step)]
    assert due[:45] == list(range(45)) and set(np.diff([step for step in due if step >= 45])) == {6}
    assert [step for step in range(20) if looks.seeks(step)] == [0, 6, 12, 18]


def test_a_result_is_kept_and_read_again(tmp_path):
    setting = shared()
    job = Job(case(), "ip", setting, name="ip: shelf")
    ((_, first),) = all_performed([job], tmp_path, "context", num_processes=1)
    stamp = next(tmp_path.glob("run-*.npz")).stat().st_mtime_ns
    ((_, again),) = all_performed([job], tmp_path, "context", num_processes=1)
    assert next(tmp_path.glob("run-*.npz")).stat().st_mtime_ns == stamp
    assert again.run.flags() == first.run.flags() and again.run.reason == first.run.reason
    np.testing.assert_array_equal(again.run.gripper, first.run.gripper)
    np.testing.assert_array_equal(again.hands[-1].position, first.hands[-1].position)
    np.testing.assert_array_equal(again.detections.place, first.detections.place)
    assert first.run.covered == again.run.covered > 0.1


def test_a_result_of_a_run_that_saw_nothing_comes_back(tmp_path):
    result = performed(Job(case(), "eaip", shared(), Faults(unseen=True, leave=0.0)))
    back = read_result(write_result(tmp_path / "run.npz", result))
    assert back.run.kind == result.run.kind and len(back.detections) == 0


def test_a_plan_through_the_object_is_a_collision():
    one = case()
    judge, motion = Judge(one.site, baxter_left_arm()), one.motion
    low = motion.gripper - [0.0, 0.0, 0.6]
    assert judge.clearance(low, motion.hands[:, 1] - [0.0, 0.0, 0.6]).collides()
    assert not judge.clearance(motion.gripper, motion.hands[:, 1]).collides()


def test_flags_are_those_of_the_kind():
    result = run()
    for kind in KINDS:
        flags = dataclasses.replace(result, kind=kind, covered=0.9).flags()
        assert set(flags) == set(SCORES)
        assert flags["success"] == (kind == "covered") and flags["held"] == (kind in ("held", "aborted"))


def test_faults_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="wrong_class"):
        Faults(wrong_class="sofa")
    with pytest.raises(InputError, match="speed"):
        Faults(speed=0.0)
