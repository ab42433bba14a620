from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.simulation import BagMesh


def test_a_bag_is_a_tube_with_one_mouth():
    mesh = BagMesh(perimeter=2.0, length=0.55, spacing=0.1)
    assert (mesh.num_columns, mesh.num_rows, mesh.num_vertices) == (20, 6, 131)
    sides = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    rim = edges[count == 1]
    assert set(count) == {1, 2} and set(rim.ravel()) == set(range(20)) and len(rim) == 20
    assert mesh.num_vertices - len(edges) + len(mesh.triangles) == 1  # Euler: a disc
    assert {tuple(edge) for edge in np.sort(mesh.edges[0], 1).tolist()} == {tuple(edge) for edge in edges.tolist()}
    assert len(mesh.edges[0]) == len(edges)


def test_edges_have_the_lengths_of_the_flat_bag():
    mesh = BagMesh(perimeter=2.0, length=0.55, spacing=0.1)
    row, column = np.divmod(np.arange(120), 20)
    flat = np.column_stack([np.minimum(column, 20 - column) * 0.1, row * 0.55 / 6])
    flat = np.concatenate([flat, np.column_stack([np.arange(11) * 0.1, np.full(11, 0.55)])])
    edges, rest = mesh.edges
    assert np.linalg.norm(flat[edges[:, 0]] - flat[edges[:, 1]], axis=1) == pytest.approx(rest)


@pytest.mark.parametrize(("width", "steps"), [(1.2, 12), (1.21, 13), (1.29, 13), (0.01, 1), (1.8, 18)])
def test_the_mouth_runs_from_hand_to_hand_and_no_edge_is_shorter_than_asked_for(width, steps):
    left, right, partners_left, partners_right = BagMesh(perimeter=4.0, length=1.0, spacing=0.1).held(width)
    assert partners_left - right == left - partners_right == steps
    robots, partners = 40 - left + right, partners_right - partners_left
    assert robots + partners == 40 - 2 * steps and 0 <= partners - robots <= 2
    assert right == 40 - left and partners_left == 40 - partners_right  # the folds are between the hands of each


def test_a_bag_starts_straight_from_its_mouth():
    mesh = BagMesh(perimeter=4.0, length=1.0, spacing=0.1)
    handles = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    points = mesh.straight(handles, mesh.held(1.2))
    assert points[mesh.held(1.2)] == pytest.approx(handles)
    assert points[:40, 2] == pytest.approx(0.0) and points[-21:, 2] == pytest.approx(1.0)  # the mouth looks down
    assert points[[0, 20]] == pytest.approx(np.array([[0.0, 0.5, 0.0], [1.0, 0.5, 0.0]]))
