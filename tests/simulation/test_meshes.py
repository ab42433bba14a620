from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation import Mesh, box, cylinder, ellipsoid, joined, picture, sheet, tube

GREY = (0.5, 0.5, 0.5)


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return abs(float((np.cross(a, b) * c).sum())) / 6.0


def edges_closed(mesh: Mesh) -> bool:
    points = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)[1].ravel()[mesh.triangles]
    directed = [tuple(edge) for triangle in points for edge in zip(triangle, np.roll(triangle, -1), strict=True)]
    return len(set(directed)) == len(directed) and {(b, a) for a, b in directed} == set(directed)


@pytest.mark.parametrize(
    ("mesh", "expected", "tolerance"),
    [
        (box((0.2, 0.3, 0.7), GREY), 0.042, 1e-12),
        (cylinder(0.3, 0.5, GREY, sides=64), np.pi * 0.09 * 0.5, 2e-3),
        (ellipsoid((0.1, 0.2, 0.3), GREY, sides=64), 4 / 3 * np.pi * 0.006, 5e-3),
        (tube((0.1, 0.2, 0.3), (0.5, -0.4, 0.9), 0.05, GREY), np.pi * 0.0025 * np.sqrt(0.88), 0.05),
        (tube((0, 0, 0), (0, 0, -1), 0.1, GREY, rounded=True), np.pi * 0.01 * (1 + 4 / 3 * 0.1), 0.06),
    ],
)
def test_a_solid_is_closed_turned_one_way_and_of_its_volume(mesh, expected, tolerance):
    assert edges_closed(mesh)
    assert volume(mesh) == pytest.approx(expected, rel=tolerance)


def test_a_capsule_reaches_from_end_to_end():
    start, end = np.array([0.1, 0.2, 0.3]), np.array([0.7, -0.4, 0.9])
    mesh, along = tube(start, end, 0.05, GREY, rounded=True), (end - start) / np.linalg.norm(end - start)
    heights = (mesh.vertices - start) @ along
    assert [heights.min(), heights.max()] == pytest.approx([-0.05, np.linalg.norm(end - start) + 0.05])
    away = np.linalg.norm(mesh.vertices - start - heights[:, None] * along, axis=1)
    assert away.max() == pytest.approx(0.05)


def test_a_picture_keeps_the_place_of_its_pixels():
    image = np.zeros((2, 3, 3), np.uint8)
    image[1, 2] = (255, 0, 0)
    mesh = picture(image, 0.3, 0.2)
    red = mesh.triangles[(mesh.color[:, 0] == 1.0)]
    assert mesh.vertices[red].reshape(-1, 3).mean(0) == pytest.approx([0.1, 0.05, 0.0], abs=0.02)
    assert mesh.vertices[red].reshape(-1, 3).min(0) == pytest.approx([0.05, 0.0, 0.0])


def test_joining_and_moving_keep_every_triangle_and_its_color():
    red, green = box((1, 1, 1), (1, 0, 0)), box((0.5, 1, 1), (0, 1, 0)).at(x=2.0)
    both = joined([red, green])
    T = np.array([[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    moved = both.moved(T)
    where = moved.vertices[moved.triangles[moved.color[:, 1] == 1.0]].reshape(-1, 3)
    assert [where.min(0), where.max(0)] == [pytest.approx([4.5, 1.75, -0.5]), pytest.approx([5.5, 2.25, 0.5])]
    assert both.vertices[:8] == pytest.approx(red.vertices)


def test_what_is_no_mesh_is_refused():
    mesh = box((1, 1, 1), GREY)
    with pytest.raises(ShapeError, match="vertices with shape"):
        Mesh(mesh.vertices[:, :2], mesh.triangles, mesh.color)
    with pytest.raises(InputError, match="indices 0 to 7"):
        Mesh(mesh.vertices[:5], mesh.triangles, mesh.color)
    with pytest.raises(InputError, match="Divide bytes"):
        Mesh(mesh.vertices, mesh.triangles, mesh.color * 255)
    with pytest.raises(InputError, match="finite"):
        Mesh(mesh.vertices * np.nan, mesh.triangles, mesh.color)
    with pytest.raises(InputError, match="between two points"):
        tube((0, 0, 0), (0, 0, 0), 0.1, GREY)
    with pytest.raises(InputError, match="at least one"):
        joined([])
    assert sheet(np.zeros((2, 2, 3)) + np.eye(3)[[[0, 1], [2, 2]]], GREY).area().min() > 0
