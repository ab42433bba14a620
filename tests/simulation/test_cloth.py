from __future__ import annotations

import numpy as np
import pytest
from scene_world import from_conf

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation import (
    ClothBag,
    ClothState,
    Obstacle,
    Workspace,
    box,
    covered_points,
    sheet,
    surface_points,
)

FLOOR = -0.93
BAG = ClothBag(perimeter=2.8, length=0.6, spacing=0.1)
CLOSED = np.array([[0.5, -0.4, -0.2], [0.5, -0.4, -0.5], [1.1, -0.4, -0.5], [1.1, -0.4, -0.2]])
CUBE = box((0.35, 0.35, 0.35), (1, 0, 0)).at(0.8, 0.0, FLOOR + 0.175)
ON_FLOOR = Obstacle.around(CUBE, FLOOR)


def ease(share):
    share = np.clip(share, 0.0, 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def sweep(thing, num, still=-0.6, end=-0.6):
    """Handles (num, 4, 3) that carry one edge of a mouth over a thing, from its right side to its left."""
    low, high = thing.extent()
    share = np.linspace(0.0, 1.0, num)
    right, top = min(low[1] - 0.12, -0.5), high[2] + 0.15
    y = right + (max(high[1] + 0.15, 0.5) - right) * ease((share - 0.15) / 0.6)
    z = -0.15 + (top + 0.15) * ease(share / 0.35) + (end - top) * ease((share - 0.6) / 0.4)
    near, far = np.full(num, low[0] - 0.1), np.full(num, high[0] + 0.1)
    held = np.full(num, right), np.full(num, still)
    return np.stack([np.stack(hand, -1) for hand in ((near, y, z), (near, *held), (far, *held), (far, y, z))], 1)


def energy(state):
    return 0.5 * (state.velocity**2).sum() + 9.81 * state.position[:, 2].sum()


def inside(bag, state, obstacle):
    """How deep the deepest of 28 points of each triangle is in the body, m."""
    weights = np.array([[i, j, 6 - i - j] for i in range(7) for j in range(7 - i)]) / 6.0
    return Obstacle(-1e3, obstacle.planes).depth(weights @ state.position[bag.layout.triangles]).max()


@pytest.fixture(scope="module")
def hung():
    return BAG.init(CLOSED, ON_FLOOR)


def test_a_closed_bag_starts_outwards():
    points = BAG.layout.straight(CLOSED, BAG.layout.held(0.7))
    assert points[-1, 1] == pytest.approx(-1.0) and points[-1, 2] == pytest.approx(-0.35)


def test_hands_take_as_much_of_the_mouth_as_they_are_apart(hung):
    other = BAG.init(CLOSED + [[0, 0, 0], [0, 0, 0], [0.3, 0, 0], [0.3, 0, 0]])
    assert hung.held[2] - hung.held[1] == 7 and other.held[2] - other.held[1] == 10


def test_a_bag_hangs_from_its_handles_without_stretching(hung):
    assert (hung.position[hung.held] == CLOSED).all()
    assert BAG.stretch(hung) < 0.03 and np.sqrt((hung.velocity**2).sum(1).mean()) < 0.2
    assert ON_FLOOR.depth(hung.position).max() <= -BAG.thickness + 1e-9
    assert hung.position[:, 1].mean() == pytest.approx(-0.4, abs=0.12)  # below the hands


def test_a_bag_comes_to_rest_and_then_gains_no_energy(hung):
    state, energies = hung, []
    for _ in range(240):
        last, state = state, BAG.step(state, CLOSED, 1 / 30, ON_FLOOR)
        energies.append(energy(state))
    # A sum over the vertices, of mass one: 0.05 is 0.03 mm of height for each.
    assert max(energies[180:]) < energies[179] + 0.05 and energies[-1] < energy(hung)
    assert np.sqrt(((state.position - last.position) ** 2).sum(1).mean()) * 30 < 0.005


def test_a_step_repeats_itself_and_leaves_its_input_alone(hung):
    position, velocity, handles = hung.position.copy(), hung.velocity.copy(), CLOSED + 0.01
    one, other = (BAG.step(hung, handles, 1 / 30, ON_FLOOR) for _ in range(2))
    assert (one.position == other.position).all() and (one.velocity == other.velocity).all()
    assert (one.position[one.held] == handles).all()
    assert (hung.position == position).all() and (hung.velocity == velocity).all() and (handles == CLOSED + 0.01).all()


def test_what_a_bag_does_hardly_depends_on_the_frame_rate(hung):
    slow, fast = hung, hung
    for frame in range(1, 11):
        moved = CLOSED + [0.0, 0.004 * frame, 0.002 * frame]
        half = CLOSED + [0.0, 0.004 * (frame - 0.5), 0.002 * (frame - 0.5)]
        slow = BAG.step(slow, moved, 1 / 30, ON_FLOOR)
        fast = BAG.step(BAG.step(fast, half, 1 / 60, ON_FLOOR), moved, 1 / 60, ON_FLOOR)
    assert np.abs(slow.position - fast.position).mean() < 1e-3


def test_hands_that_jump_do_not_break_the_cloth(hung):
    state = BAG.step(hung, CLOSED + [0.0, 0.8, 0.6], 1 / 30, ON_FLOOR)
    for _ in range(30):
        state = BAG.step(state, CLOSED + [0.0, 0.8, 0.6], 1 / 30, ON_FLOOR)
    assert np.isfinite(state.position).all() and BAG.stretch(state) < 0.1


def test_stretch_is_that_of_the_longest_edge(hung):
    pulled = hung.position.copy()
    pulled[-1] += [0.0, 0.0, 0.4]
    edges, rest = BAG.layout.edges
    longest = max(np.linalg.norm(pulled[i] - pulled[j]) / length for (i, j), length in zip(edges, rest, strict=True))
    assert BAG.stretch(ClothState(pulled, hung.velocity, hung.held)) == pytest.approx(longest - 1.0)
    assert longest > 2.0


def test_a_taut_bag_says_so(hung):
    handles = CLOSED + [[0, 0, 0], [0, 0, 0], [0.5, 0, 0], [0.5, 0, 0]]
    state = hung
    for share in np.linspace(0.1, 1.0, 10):
        state = BAG.step(state, CLOSED + share * (handles - CLOSED), 1 / 30, ON_FLOOR)
    assert BAG.stretch(state) > 0.3


def test_a_mesh_has_all_triangles_in_the_bags_colour(hung):
    mesh = BAG.mesh(hung)
    assert mesh.triangles.shape == (2 * 28 * 6, 3) and (mesh.color == np.float32(BAG.color)).all()
    assert (mesh.vertices == hung.position).all()


def test_planes_of_a_hull_are_merged_and_hold_all_of_the_mesh():
    thing = from_conf("object/office_chair").mesh()
    obstacle = Obstacle.around(thing, 0.0)
    assert len(ON_FLOOR.planes) == 6 and 20 < len(obstacle.planes) < 200
    assert Obstacle(-1e3, obstacle.planes).depth(thing.vertices).min() > -2e-4  # all inside
    assert Obstacle(-1e3, obstacle.planes).depth(thing.vertices).max() < 0.5
    assert obstacle.depth(np.array([[0.0, 0.0, -0.2], [3.0, 0.0, 0.5]])) == pytest.approx([0.2, -0.5])


@pytest.mark.slow
def test_a_small_sweep_covers_a_cube(hung):
    bag, num = ClothBag(perimeter=4.0, length=0.8, spacing=0.11), 110
    hands = sweep(CUBE, num, still=-0.75, end=-0.75)
    state, stretch = bag.init(hands[0], ON_FLOOR), []
    points = surface_points(CUBE, 300, np.random.default_rng(0))
    points = points[points[:, 2] > FLOOR + 0.2]
    for frame, handles in enumerate(hands):
        state = bag.step(state, handles, 1 / 30, ON_FLOOR)
        stretch.append(bag.stretch(state))
        if frame == num // 3:
            assert covered_points(points, bag.mesh(state), (0.8, 0.0)).mean() < 0.5
    assert covered_points(points, bag.mesh(state), (0.8, 0.0)).mean() > 0.9
    assert max(stretch) < 0.15 and inside(bag, state, ON_FLOOR) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stepladder", "folding_table", "office_chair", "brown_bookshelf"])
def test_a_sweep_covers_a_training_object_and_half_a_sweep_does_not(name):
    room = Workspace(from_conf(f"object/{name}"), thing_turn=-0.6, thing_position=(0.92, 0.05))
    obstacle, bag, hands = Obstacle.around(room.placed, room.floor), ClothBag(), sweep(room.placed, 300)
    points = surface_points(room.placed, 1500, np.random.default_rng(0))
    points = points[points[:, 2] > room.floor + 0.35]
    state, stretch, covered, deepest = bag.init(hands[0], obstacle), [], {}, []
    for frame, handles in enumerate(hands):
        state = bag.step(state, handles, 1 / 30, obstacle)
        stretch.append(bag.stretch(state))
        if frame % 10 == 0:
            deepest.append(inside(bag, state, obstacle))
        if frame in (140, 299):
            covered[frame] = covered_points(points, bag.mesh(state), room.thing_position).mean()
    assert covered[299] > 0.93 and covered[140] < 0.7
    assert max(stretch) < 0.2 and max(deepest) < 0.03


def test_a_room_shows_the_bag_that_was_simulated(hung):
    room = Workspace(from_conf("object/folding_table"), bag=None)
    hands = np.array([[1.3, -0.3, 0.2], [1.3, 0.3, 0.2]])
    for place in (room, Workspace(room.thing)):
        scene = place.scene(hands, hands[::-1], bag=BAG.mesh(hung))
        assert (scene.parts[scene.index("bag")].mesh.vertices == hung.position).all()
    assert "bag" not in [part.name for part in room.scene(hands, hands[::-1]).parts]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"perimeter": 0.0}, "lengths of a bag above zero and finite"),
        ({"length": np.nan}, "lengths of a bag above zero and finite"),
        ({"spacing": 0.7}, "leaves two rows and eight columns"),
        ({"friction": -0.1}, "not below zero"),
        ({"drag": np.inf}, "not below zero"),
    ],
)
def test_bags_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        ClothBag(**arguments)


def test_what_no_bag_can_follow_is_refused(hung):
    with pytest.raises(ShapeError, match=r"handles with shape \(4, 3\).*got \(3, 3\)"):
        BAG.init(CLOSED[:3])
    with pytest.raises(InputError, match="handles that are finite"):
        BAG.step(hung, np.where(CLOSED > 1.0, np.nan, CLOSED), 1 / 30, ON_FLOOR)
    with pytest.raises(InputError, match="dt above zero"):
        BAG.step(hung, CLOSED, 0.0, ON_FLOOR)
    with pytest.raises(ShapeError, match="this bag's 183 vertices.*Start with init"):
        BAG.stretch(ClothState(hung.position[1:], hung.velocity[1:], hung.held))
    with pytest.raises(InputError, match="width of the mouth above zero and up to 1.2 m, got 1.37 m"):
        BAG.init(CLOSED * [1.0, 1.0, 1.0] + [[0, 0, 0], [0, 0, 0], [0.7, 0, 0], [0.7, 0, 0]])
    with pytest.raises(InputError, match="at most 0.6 m apart.*got 1.3 m"):
        BAG.init(CLOSED + [[0, 0, 1.0], [0, 0, 0], [0, 0, 0], [0, 0, 1.0]])


def test_obstacles_that_cannot_be_are_refused():
    with pytest.raises(ShapeError, match=r"planes with shape \(any, 4\), got \(2, 3\)"):
        Obstacle(0.0, np.zeros((2, 3)))
    with pytest.raises(InputError, match="normals of length one"):
        Obstacle(0.0, np.full((1, 4), 0.9))
    with pytest.raises(InputError, match="floor and planes that are finite"):
        Obstacle(np.nan)
    flat = sheet(np.stack([*np.meshgrid([0.0, 1.0], [0.0, 1.0]), np.zeros((2, 2))], -1), (1, 1, 1))
    with pytest.raises(InputError, match=r"a volume, got one of \[1.0, 1.0, 0.0\] m"):
        Obstacle.around(flat, 0.0)
