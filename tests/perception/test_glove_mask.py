from __future__ import annotations

import dataclasses

import glove_world as world
import numpy as np
import pytest
from scipy.spatial import KDTree

from eaip_prob.errors import InputError
from eaip_prob.perception.glove_mask import GloveColor, glove_mask, glove_points

LEFT, RIGHT = np.array([0.9, -0.3, 0.1]), np.array([0.8, 0.3, 0.2])


def off_gloves(points, radius=0.05):
    """Distance of each point from the nearer glove's surface, m."""
    away = np.stack([np.linalg.norm(points - center, axis=1) for center in (LEFT, RIGHT)])
    return np.abs(away.min(0) - radius)


def test_mask_takes_green_and_nothing_else():
    paints = [(40, 180, 70), (180, 40, 40), (128, 128, 128), (8, 20, 9), (40, 70, 180), (150, 180, 150)]
    image = np.repeat(np.array(paints, np.uint8), 9, axis=0)[None].repeat(9, axis=0)
    found = glove_mask(image, GloveColor())
    assert found[1:-1, 1:8].all() and not found[:, 8:].any() and not found[0].any()


@pytest.mark.parametrize("name", world.CAMERAS)
def test_points_lie_on_the_gloves(name):
    found = glove_points(world.frame(name, world.gloves(LEFT, RIGHT), 0.0))
    assert len(found.points) > 200 and off_gloves(found.points).max() < 1e-4
    to_camera = world.CAMERAS[name][:3, 3] - found.points
    np.testing.assert_allclose(found.views, -to_camera / np.linalg.norm(to_camera, axis=1)[:, None], atol=1e-9)


def test_all_that_is_green_is_found():
    """Every pixel of the depth image well inside a glove's outline."""
    frame = world.frame("left", world.gloves(LEFT, RIGHT), 0.0)
    points = frame.points()
    inside = np.zeros(len(points), dtype=bool)
    for center in (LEFT, RIGHT):
        towards = center - world.CAMERAS["left"][:3, 3]
        normal = (points - center) / 0.05
        inside |= (np.abs(np.linalg.norm(normal, axis=1) - 1.0) < 1e-3) & (
            normal @ -towards / np.linalg.norm(towards) > 0.8
        )
    distance, _ = KDTree(glove_points(frame).points).query(points[inside])
    assert inside.sum() > 100 and distance.max() < 1e-6


def test_wall_behind_the_edge_of_a_glove_is_not_painted():
    """A wide baseline: the depth camera sees wall that the colour camera has behind the glove."""
    frame = world.frame("overhead", world.gloves(LEFT, RIGHT), 0.0)
    aside = world.T_COLOR_DEPTH.copy()
    aside[0, 3] = -0.15
    _, color = world.cast(world.COLOR, world.CAMERAS["overhead"] @ np.linalg.inv(aside), world.gloves(LEFT, RIGHT))
    frame = dataclasses.replace(frame, color=color, T_color_depth=aside)
    found = glove_points(frame).points
    assert len(found) > 200 and off_gloves(found).max() < 1e-4


def test_registered_colour_needs_no_second_camera():
    pose = world.CAMERAS["left"]
    depth, color = world.cast(world.KINECT, pose, world.gloves(LEFT, RIGHT))
    frame = world.frame("left", world.gloves(LEFT, RIGHT), 0.0)
    frame = dataclasses.replace(
        frame, color=color, depth=depth.astype(np.float32), valid=depth < 9, color_intrinsics=None, T_color_depth=None
    )
    found = glove_points(frame).points
    assert len(found) > 200 and off_gloves(found).max() < 1e-4


def test_large_colour_image_is_read_at_every_fourth_pixel():
    frame = world.frame("left", world.gloves(LEFT, RIGHT), 0.0)
    large = dataclasses.replace(
        frame,
        color=np.ascontiguousarray(frame.color.repeat(4, 0).repeat(4, 1)),
        color_intrinsics=world.COLOR.scaled(1920, 1080),
    )
    found, few = glove_points(large).points, glove_points(frame).points
    assert off_gloves(found).max() < 0.05 and abs(len(found) - len(few)) < 0.2 * len(few)


def test_no_green_no_points():
    assert not len(glove_points(world.frame("left", [], 0.0)).points)


def test_hue_is_a_range():
    with pytest.raises(InputError, match="lowest, highest"):
        GloveColor(hue=(80, 45))
