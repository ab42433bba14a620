from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from covering_world import TRAINED, perception, recorded

from eaip_prob.detection import Detections, MetricBoxEncoder, PaperEncoder
from eaip_prob.errors import DataFileError, InputError
from eaip_prob.tasks.bag_covering import running
from eaip_prob.tasks.bag_covering.demonstrating import seen_by
from eaip_prob.tasks.bag_covering.recorded import demonstration_set, load_recorded, save_recorded, shipped
from eaip_prob.tasks.bag_covering.telling import tells


def test_a_set_comes_back_as_it_was_saved(tmp_path):
    one = recorded()[0]
    nothing = dataclasses.replace(one, detections=Detections.none(one.detections.image_size))
    back = load_recorded(save_recorded(tmp_path / "set.npz", [one, nothing]))
    np.testing.assert_array_equal(back[0].gripper, one.gripper)
    for was, now in zip(one.hands, back[0].hands, strict=True):
        assert was.time == now.time
        np.testing.assert_array_equal(was.position, now.position)
        np.testing.assert_array_equal(was.covariance, now.covariance)
        np.testing.assert_array_equal(was.seen, now.seen)
    np.testing.assert_array_equal(back[0].detections.place, one.detections.place)
    assert back[0].detections.labels == one.detections.labels and len(back[1].detections) == 0
    np.testing.assert_array_equal(back[0].truth.box, one.truth.box)


def test_what_is_no_set_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(DataFileError, match="Expected arrays"):
        load_recorded(tmp_path / "other.npz")
    with pytest.raises(DataFileError, match="no such file"):
        load_recorded(tmp_path / "none.npz")
    with pytest.raises(InputError, match="at least one"):
        save_recorded(tmp_path / "empty.npz", [])


def test_the_set_of_the_package_is_what_the_paper_asks_for():
    found = shipped()
    counts = {name: sum(one.thing == name for one in found) for name in TRAINED}
    assert counts == dict.fromkeys(TRAINED, 10)
    assert len({one.partner for one in found}) == 10
    for encoder, least in ((PaperEncoder(), 1.0), (MetricBoxEncoder(), 0.9)):
        assert float(demonstration_set(found, encoder).environments.observed.double().mean()) >= least
    seen = np.concatenate([hand.seen for one in found for hand in one.hands])
    assert seen.mean() > 0.8


def test_another_detector_reads_what_the_object_truly_was():
    found = shipped()
    for one, was in zip(seen_by(found, perception()), found, strict=True):
        assert one.detections.labels == (was.truth.label,)
        assert np.abs(one.detections.place[0] - was.truth.place).max() < 0.15
        assert one.hands is was.hands


def test_what_the_first_second_tells_is_between_chance_and_all():
    told = tells(shipped())
    assert 0.25 < told["decodable/object"] < 1.0 and told["decodable/size"] < 1.0


def test_results_follow_from_the_demonstrations_of_the_package(tmp_path, monkeypatch):
    package = tmp_path / "eaip_prob"
    place = package / "tasks" / "bag_covering"
    place.mkdir(parents=True)
    (place / "running.py").write_text("code")
    monkeypatch.setattr(running, "__file__", str(place / "running.py"))
    digests = [running.source_digest()]
    for name in ("demonstrations.npz", "weights.safetensors", "other.py", "notes.md"):
        (place / name).write_text(name)
        digests.append(running.source_digest())
    assert len(set(digests[:4])) == 4 and digests[4] == digests[3]
