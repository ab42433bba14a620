from __future__ import annotations

import numpy as np
import pytest
from covering_world import TRAINED, room, silhouette_clearance

from eaip_prob.errors import InputError
from eaip_prob.simulation import Bookshelf, Workspace
from eaip_prob.tasks.bag_covering.motion import planned
from eaip_prob.tasks.bag_covering.people import TEST, TRAINING, Partner
from eaip_prob.tasks.bag_covering.site import Site, drawn_site

SHELF = Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))


def site(height: float = 0.9) -> Site:
    shelf = Bookshelf(0.4, 0.3, height, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1))
    return Site("shelf", "bookshelf", Workspace(shelf))


@pytest.mark.parametrize("population", [TRAINING, TEST])
def test_every_planned_motion_clears_its_object(population):
    for case in room().cases(list(room().things), population, 4, seed=3):
        place, motion = case.site, case.motion
        for path in (motion.gripper, motion.hands[:, 1]):
            assert silhouette_clearance(place.low, place.high, path) > 0.04, case.name


def test_motions_are_smooth_and_rest_at_both_ends():
    calm = Partner(tremor=0.0)
    motion = planned(site(), calm, np.random.default_rng(0))
    velocity = np.diff(motion.gripper, axis=0) * 30.0
    assert np.linalg.norm(velocity[[0, -1]], axis=-1).max() < 0.02
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max() * 30.0 < 2.0  # m/s^2


@pytest.mark.parametrize("cue, tells", [(0.0, False), (1.0, True)])
def test_the_cue_is_what_the_first_second_tells(cue, tells):
    low, high = (planned(site(h), Partner(), np.random.default_rng(0), cue).hands[:31, 1] for h in (0.5, 1.0))
    apart = np.linalg.norm(low - high, axis=-1).max()
    assert (apart > 0.02) if tells else (apart < 1e-9)


def test_half_a_cue_is_half_the_difference():
    def turn(cue):
        low, high = (planned(site(h), Partner(), np.random.default_rng(0), cue).hands[36, 1] for h in (0.5, 1.0))
        return high - low

    np.testing.assert_allclose(turn(0.5), 0.5 * turn(1.0), atol=1e-3)


@pytest.mark.parametrize("cue", [-0.1, 1.1])
def test_a_cue_out_of_range_is_refused(cue):
    with pytest.raises(InputError, match="cue from 0 to 1"):
        planned(site(), Partner(), np.random.default_rng(0), cue)


def test_test_partners_are_outside_the_range_of_training_partners():
    def people(population):
        drawn = [Partner.drawn(population, i, np.random.default_rng(i)) for i in range(40)]
        return np.array([[one.stature, one.tempo] for one in drawn])

    training, test = people(TRAINING), people(TEST)
    for column in (0, 1):
        inside = (test[:, column] > training[:, column].min()) & (test[:, column] < training[:, column].max())
        assert not inside.any()
    assert (test < training.min(0)).any(0).all() and (test > training.max(0)).any(0).all()


def test_a_case_does_not_depend_on_the_others():
    alone = room().cases(["stepladder"], TEST, 2, seed=5)[1]
    among = next(c for c in room().cases(list(room().things), TEST, 2, seed=5) if c.name == alone.name)
    np.testing.assert_array_equal(alone.motion.hands, among.motion.hands)
    assert alone.seed == among.seed


def test_the_cue_leaves_places_and_people_as_they_are():
    weak, strong = (room().cases(TRAINED, TRAINING, 1, seed=0, cue=cue) for cue in (0.0, 1.0))
    for one, other in zip(weak, strong, strict=True):
        np.testing.assert_array_equal(one.site.place, other.site.place)
        np.testing.assert_allclose(one.motion.gripper[-1], other.motion.gripper[-1], atol=1e-3)


def test_unknown_objects_and_classes_are_refused():
    with pytest.raises(InputError, match="an object among"):
        drawn_site("sofa", room().things, room().labels, room().workspace, np.random.default_rng(0))
    with pytest.raises(InputError, match="one of the classes"):
        Site("sofa", "sofa", Workspace(SHELF))


def test_an_object_outside_the_workspace_is_refused_with_what_to_do():
    with pytest.raises(InputError, match="Move or turn it"):
        Site("shelf", "bookshelf", Workspace(SHELF, thing_position=(2.0, 0.0)))


def test_a_population_nobody_knows_is_refused():
    with pytest.raises(InputError, match="population"):
        Partner.drawn("robots", 0, np.random.default_rng(0))
