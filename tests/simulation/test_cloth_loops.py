from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial import ConvexHull

from eaip_prob.simulation import _cloth_loops as loops

G, H = 9.81, 1.0 / 1500.0
NO_TRIANGLES, NO_PLANES = np.zeros((0, 3), np.int64), np.zeros((0, 4))
NOBODY = np.zeros(0, np.int64)


def carried(
    position, num, velocity=None, held=NOBODY, ends=None, edges=(), rest=(), floor=-1e3, drag=0.0, friction=0.0
):
    """Position and velocity after `num` substeps, of a chain or of loose vertices."""
    position = np.array(position, float)
    velocity = np.zeros_like(position) if velocity is None else np.array(velocity, float)
    free = np.ones(len(position))
    free[held] = 0.0
    start = position[held]
    arguments = np.reshape(np.array(edges, np.int64), (-1, 2)), np.array(rest, float), NO_TRIANGLES, NO_PLANES, floor
    ends = start if ends is None else ends
    loops.advance(position, velocity, free, held, start, ends, *arguments, (G, drag, friction, 0.0), H, num)
    return position, velocity


def hull_planes(points):
    return ConvexHull(points).equations * [1.0, 1.0, 1.0, -1.0]


def test_a_free_vertex_falls_as_galilei_says():
    (x, y, z), (_, _, speed) = (array[0] for array in carried([[0.1, 0.2, 3.0]], 600, velocity=[[0.5, 0.0, 0.0]]))
    t = 600 * H
    assert (x, y) == (pytest.approx(0.1 + 0.5 * t), 0.2)
    assert 3.0 - z == pytest.approx(0.5 * G * t**2, rel=2 / 600) and speed == pytest.approx(-G * t)


def test_drag_leads_to_the_terminal_speed():
    _, velocity = carried([[0.0, 0.0, 0.0]], 4500, drag=3.0)
    assert velocity[0] == pytest.approx([0.0, 0.0, -G / 3.0], rel=3e-3)


def test_a_vertex_slides_on_the_floor_as_far_as_coulomb_says():
    position, velocity = carried([[0.0, 0.0, 0.0]], 1500, [[0.6, 0.8, 0.0]], floor=0.0, friction=0.25)
    distance = 1.0 / (2 * 0.25 * G)
    assert position[0] == pytest.approx([0.6 * distance, 0.8 * distance, 0.0], rel=5e-3, abs=1e-9)
    assert np.abs(velocity).max() == 0.0


def test_a_chain_between_two_hands_hangs_as_a_catenary():
    num, length, apart = 41, 1.0, 0.6
    points = np.column_stack([np.linspace(0.0, apart, num), np.zeros(num), np.zeros(num)])
    edges = np.column_stack([np.arange(num - 1), np.arange(1, num)])
    rest = np.full(num - 1, length / (num - 1))
    position, _ = carried(points, 9000, held=np.array([0, num - 1]), edges=edges, rest=rest, drag=3.0)
    a = brentq(lambda a: 2 * a * np.sinh(apart / (2 * a)) - length, 0.05, 5.0)
    lines = a * (np.cosh((position[:, 0] - apart / 2) / a) - np.cosh(apart / (2 * a)))
    assert position[:, 2] == pytest.approx(lines, abs=0.006) and position[:, 2].min() < -0.3
    assert np.abs(np.linalg.norm(np.diff(position, axis=0), axis=1) / rest - 1.0).max() < 0.01


def test_a_stretched_edge_swings_out():
    position, velocity = carried([[0.0, 0.0, 0.0], [1.3, 0.0, 0.0]], 100, edges=[[0, 1]], rest=[1.0])
    assert np.ptp(position[:, 0]) == pytest.approx(1.0, abs=1e-3)
    assert np.abs(velocity[:, 0]).max() < 1e-3


def test_handles_go_straight_and_end_where_they_are_told():
    end = np.array([[0.3, 0.1, 0.7]])
    position, velocity = carried([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], 7, held=np.array([0]), ends=end)
    assert position[0].tolist() == end[0].tolist()
    assert velocity[0] == pytest.approx((end[0] - [0.0, 0.0, 1.0]) / (7 * H))


@pytest.mark.parametrize(("length", "moves"), [(1.1, 0.1), (0.9, -0.1)])
def test_an_edge_is_pulled_more_than_it_is_pushed(length, moves):
    position = np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0]])
    loops.straighten(position, np.ones(2), np.array([[0, 1]]), np.array([1.0]))
    share = (length - np.ptp(position[:, 0])) / moves
    assert position.mean(0) == pytest.approx([length / 2, 0.0, 0.0])  # no momentum comes from nowhere
    assert share == pytest.approx(1.1 if length > 1.0 else 0.1, rel=0.1)


def test_a_held_vertex_is_not_moved_by_an_edge():
    position = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.4, 0.0]])
    loops.straighten(position, np.array([0.0, 1.0, 0.0]), np.array([[0, 1], [0, 2]]), np.ones(2))
    assert position[0].tolist() == [0.0, 0.0, 0.0] and position[2].tolist() == [0.0, 1.4, 0.0]
    assert position[1, 0] < 1.0 + 0.3 * 0.2


def test_vertices_leave_a_body_along_its_nearest_plane(margin=0.05):
    generator = np.random.default_rng(2)
    planes = hull_planes(generator.normal(size=(25, 3)))
    points = generator.uniform(-2.0, 2.0, (400, 3))
    expected = points.copy()
    for point in expected:
        depths = [
            margin + offset - normal @ point for *normal, offset in planes.tolist() for normal in [np.array(normal)]
        ]
        if min(depths) > 0.0:
            nearest = int(np.argmin(depths))
            point += depths[nearest] * planes[nearest, :3]
    out, first = points.copy(), generator.integers(len(planes), size=400)
    loops.put_vertices_out(out, points.copy(), np.ones(400), planes, -1e3, margin, 0.0, first)
    assert 50 < (expected != points).any(1).sum() < 350
    assert out == pytest.approx(expected, abs=1e-12)


def test_a_vertex_that_was_buried_is_not_shot_out():
    position, before = np.array([[0.0, 0.0, -0.3]]), np.array([[0.0, 0.0, -0.29]])
    loops.put_vertices_out(position, before, np.ones(1), NO_PLANES, 0.0, 0.0, 0.3, np.zeros(1, np.int64))
    assert position[0].tolist() == before[0].tolist() == [0.0, 0.0, 0.0]


def test_friction_holds_what_slides_less_than_its_share_of_the_depth():
    for slide, left in ((0.01, 0.0), (0.05, 0.03)):
        position, before = np.array([[slide, 0.0, -0.1]]), np.array([[0.0, 0.0, 0.0]])
        loops.put_vertices_out(position, before, np.ones(1), NO_PLANES, 0.0, 0.0, 0.2, np.zeros(1, np.int64))
        assert position[0] == pytest.approx([left, 0.0, 0.0], abs=1e-12)


ROOF = np.array([[np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0], [-np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]])  # ridge: x = z = 0


def centre_put_out(corners, times=1):
    position = np.array(corners, float)
    for _ in range(times):
        before = position.copy()
        loops.put_centres_out(
            position, before, np.ones(3), np.array([[0, 1, 2]]), ROOF, -9.0, 0.0, np.zeros(1, np.int64)
        )
    return position, before


def test_a_triangle_over_a_ridge_is_lifted_along_its_own_normal_until_its_centre_is_out():
    corners = [[-0.8, 0.0, -0.3], [0.7, 1.0, -0.3], [0.7, -1.0, -0.3]]
    once, _ = centre_put_out(corners)
    assert (once - corners)[:, :2] == pytest.approx(0.0, abs=1e-12)
    often, _ = centre_put_out(corners, times=40)
    assert (often - corners)[:, 2] == pytest.approx(0.3 - 0.2, abs=1e-6)  # the centre's x is 0.2


def test_a_triangle_across_a_plane_leaves_along_the_plane():
    corners = np.array([[0.1, 0.0, -0.2], [0.3, 0.05, -0.4], [0.3, 0.0, -0.3]])  # 17 degrees off upright
    once, _ = centre_put_out(corners)
    push = once[0] - corners[0]
    assert push / np.linalg.norm(push) == pytest.approx(ROOF[0, :3])


def test_a_triangle_that_is_lifted_gets_no_speed_and_one_that_falls_in_is_stopped():
    position, before = centre_put_out([[-0.5, 0.0, -0.3], [0.5, 1.0, -0.3], [0.5, -1.0, -0.3]])
    assert position == pytest.approx(before)
    falling = np.array([[-0.8, 0.0, -0.3], [0.7, 1.0, -0.3], [0.7, -1.0, -0.3]])
    before = falling + [0.0, 0.0, 0.5]
    loops.put_centres_out(falling, before, np.ones(3), np.array([[0, 1, 2]]), ROOF, -9.0, 0.0, np.zeros(1, np.int64))
    assert (before[:, 2] == 0.2).all() and (falling[:, 2] > -0.3).all()


def test_the_floor_stops_triangles_too():
    position = np.array([[0.0, 0.0, 0.3], [1.0, 0.0, -0.6], [0.0, 1.0, -0.6]])
    free = np.array([0.0, 1.0, 1.0])
    loops.put_centres_out(
        position, position.copy(), free, np.array([[0, 1, 2]]), NO_PLANES, 0.0, 0.0, np.zeros(1, np.int64)
    )
    assert position[:, 2].tolist() == [0.3, pytest.approx(-0.3), pytest.approx(-0.3)]
