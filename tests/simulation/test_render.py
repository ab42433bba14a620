from __future__ import annotations

import numpy as np
import pytest
from scene_world import from_conf, small_camera, two_boxes

from eaip_prob.data.frames import Intrinsics
from eaip_prob.errors import InputError
from eaip_prob.simulation import Lighting, Part, Scene, View, box, looking_at, render_color, render_depth, render_rgbd


def nearest_hit(scene, ray):
    """Moeller and Trumbore (1997), one triangle after the other."""
    best, origin, direction = np.inf, ray[:3].astype(float), ray[3:].astype(float)
    for part in scene.parts:
        for a, b, c in part.mesh.vertices[part.mesh.triangles]:
            across = np.cross(direction, c - a)
            size = (b - a) @ across
            if abs(size) > 1e-12:
                u = (origin - a) @ across / size
                turned = np.cross(origin - a, b - a)
                v, t = direction @ turned / size, (c - a) @ turned / size
                if u >= 0 and v >= 0 and u + v <= 1 and t > 0:
                    best = min(best, t)
    return best


def test_depth_agrees_with_a_slow_loop_over_triangles():
    scene, view = two_boxes(), small_camera().depth_view
    labels = render_depth(scene, view)
    for row, column in [(5, 9), (26, 31), (30, 40), (52, 63), (40, 12)]:
        assert labels.depth[row, column] == pytest.approx(nearest_hit(scene, view.rays[row, column]), rel=1e-5)


def test_points_of_a_frame_lie_on_what_their_label_says():
    scene, camera = two_boxes(), small_camera()
    frame, labels = render_rgbd(scene, camera, 0.5)
    points, red = frame.points(), labels.instance[frame.valid] == scene.index("red")
    low, high = scene.parts[1].mesh.extent()
    assert red.sum() > 50 and (points[red] > low - 1e-4).all() and (points[red] < high + 1e-4).all()
    assert np.abs(points[~red][:, 2] + 0.5).max() < 1e-4
    floor = labels.instance == 0
    assert labels.normal[floor] == pytest.approx(np.tile([0.0, 0.0, 1.0], (floor.sum(), 1)))
    directions = camera.depth_view.rays[..., 3:]
    cosine = -directions[floor][:, 2] / np.linalg.norm(directions[floor], axis=1)
    assert np.cos(labels.incidence[floor]) == pytest.approx(cosine, abs=1e-5)


def test_colour_and_depth_camera_see_one_scene_each_from_its_place():
    scene, camera = two_boxes(), small_camera()
    frame, labels = render_rgbd(scene, camera, 0.5)
    red = (labels.instance == 1) & frame.valid
    points = np.concatenate([frame.intrinsics.rays, np.ones((*red.shape, 1))], -1)[red] * frame.depth[red][:, None]
    T = frame.T_color_depth
    pixels = frame.color_intrinsics.project(points @ T[:3, :3].T + T[:3, 3]).round().astype(int)
    color = frame.color[pixels[:, 1], pixels[:, 0]].astype(int)
    assert (color[:, 0] > 2 * color[:, 1]).mean() > 0.97


def test_a_shadow_lies_where_the_lamp_is_hidden_and_only_there():
    lamp, block = np.array([0.0, 0.0, 3.0]), box((0.4, 0.4, 0.1), (0.5, 0.5, 0.5)).at(0.0, 0.0, 1.0)
    scene = Scene([Part("floor", box((8.0, 8.0, 0.2), (1.0, 1.0, 1.0)).at(z=-0.1)), Part("block", block)])
    view = View(Intrinsics(60, 60, 40.0, 40.0, 29.5, 29.5), looking_at((-3.0, 0.0, 0.9), (0.0, 0.0, 0.1)))
    image = render_color(scene, view, Lighting(lamp=tuple(lamp), highlight=0.0))
    labels = render_depth(scene, view)
    points = view.rays[..., :3] + np.where(labels.hit, labels.depth, 0.0)[..., None] * view.rays[..., 3:]
    floor = labels.instance == 0
    # The underside, at 0.95 m, throws 0.2 m to each side to 0.2 * 3 / 2.05 on the floor.
    reach = np.abs(points[floor][:, :2]).max(1)
    dark = image[floor][:, 0] < 150
    assert dark[reach < 0.27].all() and (reach < 0.27).sum() > 10
    assert not dark[reach > 0.32].any() and not dark[reach > 3.0].any()


def test_a_surface_does_not_shade_itself():
    scene = Scene([Part("floor", box((8.0, 8.0, 0.2), (0.6, 0.6, 0.6)).at(z=-0.1))])
    view = View(Intrinsics(60, 60, 60.0, 60.0, 29.5, 29.5), looking_at((-2.0, 0.0, 2.0), (0.0, 0.0, 0.0)))
    image = render_color(scene, view, Lighting(lamp=(0.0, 0.0, 2.0), highlight=0.0))
    rough = np.abs(np.diff(image[..., 0].astype(int), axis=1))
    assert rough.max() <= 2


def test_an_edge_is_smooth_with_more_rays_a_pixel():
    wall = box((0.1, 0.5, 1.0), (1.0, 1.0, 1.0)).at(x=1.0, y=0.27)
    view = View(Intrinsics(10, 10, 10.0, 10.0, 4.5, 4.5), looking_at((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    dark = Lighting(background=(0.0, 0.0, 0.0), ambient=1.0, lamp_light=0.0, highlight=0.0)
    image = render_color(Scene([Part("wall", wall)]), view, dark, oversample=8)
    # The wall's edge is at y = 0.02, 0.95 m away: column 4.5 - 10 * 0.02 / 0.95 = 4.289, 0.789 of column 4.
    assert image[5, 4, 0] == pytest.approx(255 * 0.789, abs=255 / 8 / 1.5)
    assert image[5, 3, 0] == 255 and image[5, 5, 0] == 0
    with pytest.raises(InputError, match="oversample of at least 1"):
        render_color(Scene([Part("wall", wall)]), view, dark, oversample=0)


def test_a_scene_refuses_names_that_are_no_names():
    cube = box((1, 1, 1), (0, 0, 0))
    with pytest.raises(InputError, match="names of their own"):
        Scene([Part("a", cube), Part("a", cube)])
    with pytest.raises(InputError, match="got 'b'"):
        Scene([Part("a", cube)]).index("b")
    with pytest.raises(InputError, match="at least zero"):
        Lighting(sky=-0.1)


@pytest.mark.slow
def test_every_glove_is_seen_by_two_cameras_wherever_hands_are_above_the_object():
    cameras = from_conf("rig/three_kinects").cameras(from_conf("camera/kinect_v2"))
    thing = from_conf("object/brown_bookshelf")
    workspace = from_conf("workspace/bag_covering", thing=thing)
    for y, z in [(-0.35, 0.1), (0.0, 0.35), (0.35, 0.1)]:
        scene = workspace.scene(
            np.array([[1.25, y - 0.2, z], [1.25, y + 0.2, z]]), np.array([[0.6, y + 0.2, z], [0.6, y - 0.2, z]])
        )
        seen = [render_depth(scene, camera.depth_view).instance for camera in cameras]
        for name in ("left_glove", "right_glove"):
            assert sum((labels == scene.index(name)).sum() >= 40 for labels in seen) >= 2
