from __future__ import annotations

import numpy as np
import pytest
from scene_world import from_conf, small_camera, two_boxes

from eaip_prob.errors import InputError, ShapeError
from eaip_prob.simulation import Clip, KinectModel, KinectNoise, Person, Rig, Workspace, bent, box, looking_at
from eaip_prob.simulation.furniture import AbstractObject


class Cube(AbstractObject):
    def __repr__(self):
        return "Cube"

    def mesh(self):
        return box((0.4, 0.4, 0.4), (0.8, 0.2, 0.2)).at(z=0.2)


HANDS = np.array([[[1.2, -0.3, 0.2], [1.25, 0.3, 0.1]], [[1.2, -0.3, 0.25], [1.25, 0.3, 0.15]]])
GRIPPERS = HANDS[:, ::-1] - [0.6, 0.0, 0.0]


def test_a_camera_is_upright_and_looks_at_its_target():
    T = looking_at((0.5, 1.7, 1.2), (0.9, 0.1, -0.2))
    local = T[:3, :3].T @ (np.array([0.9, 0.1, -0.2]) - T[:3, 3])
    assert local[:2] == pytest.approx([0.0, 0.0], abs=1e-12) and local[2] > 0
    assert T[2, 0] == 0.0 and T[2, 1] < 0 and np.cross(T[:3, 0], T[:3, 1]) == pytest.approx(T[:3, 2])
    with pytest.raises(InputError, match="sideways"):
        looking_at((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="a target for each camera"):
        Rig({"left": (0.0, 0.0, 0.0)}, {"right": (1.0, 0.0, 0.0)})


def test_the_colour_camera_is_where_the_baseline_says():
    camera = small_camera()
    T_world_color = camera.T_world_camera @ np.linalg.inv(camera.model.T_color_depth)
    assert camera.color_view.T_world_camera == pytest.approx(T_world_color, abs=1e-12)
    with pytest.raises(ShapeError, match="baseline"):
        KinectModel(camera.model.depth, camera.model.color, (0.1, 0.2))


def test_the_kinect_has_the_angles_of_its_data_sheet():
    model = from_conf("camera/kinect_v2")
    for camera, (across, down) in [(model.depth, (70.6, 60.0)), (model.color, (84.1, 53.8))]:
        x, y = (camera.width - 1) / 2, (camera.height - 1) / 2
        ends = np.array([[0, y], [2 * x, y], [x, 0], [x, 2 * y]])
        rays = np.degrees(np.arctan(camera.unproject(ends, np.ones(4))))
        width, height = rays[1, 0] - rays[0, 0], rays[3, 1] - rays[2, 1]
        assert [width, height] == pytest.approx([across, down], abs=2.0)
    assert (model.color_camera.width, model.color_camera.height) == (480, 270)
    assert 1.0 / 1000 < abs(model.baseline[0]) < 0.06


def test_an_arm_bends_so_that_both_links_keep_their_length():
    start, end = np.array([0.1, 0.2, 0.3]), np.array([0.4, -0.1, 0.2])
    elbow = bent(start, end, 0.3, 0.25, np.array([0.0, 0.0, -1.0]))
    assert [np.linalg.norm(elbow - start), np.linalg.norm(end - elbow)] == pytest.approx([0.3, 0.25])
    assert elbow[2] < min(start[2], end[2])


@pytest.mark.parametrize("reach", [1.3, 1.0, 0.7])
def test_gloves_are_where_they_are_told_to_be_and_arms_reach_them(reach):
    hands = np.array([[reach, -0.35, 0.1], [reach, 0.2, 0.3]])
    person = Person(glove_radii=(0.04, 0.05, 0.06))
    meshes = person.meshes(hands, (1.8, 0.0, -0.93))
    for name, hand in zip(("left_glove", "right_glove"), hands, strict=True):
        assert meshes[name].extent().mean(0) == pytest.approx(hand)
        assert np.ptp(meshes[name].extent(), axis=0) == pytest.approx([0.08, 0.10, 0.12])
        # The arm ends inside the glove.
        assert np.linalg.norm(meshes["person"].vertices - hand, axis=1).min() < 0.06
    shoulders = person._shoulders(hands, np.array([1.8, 0.0, -0.93]))
    assert np.linalg.norm(hands - shoulders, axis=1).max() <= sum(person._links) + 1e-6
    with pytest.raises(ShapeError, match="left then right"):
        person.meshes(hands[:1], (1.8, 0.0, -0.93))


def test_the_bag_hangs_from_the_four_hands():
    workspace = Workspace(Cube())
    scene = workspace.scene(HANDS[0], GRIPPERS[0])
    vertices = scene.parts[scene.index("bag")].mesh.vertices
    for point in (*HANDS[0], *GRIPPERS[0]):
        assert np.linalg.norm(vertices - point, axis=1).min() < 1e-12
    # Its long edges run from a gripper to the hand on the same side, which is the partner's other hand.
    for gripper, hand in zip(GRIPPERS[0], HANDS[0, ::-1], strict=True):
        assert np.linalg.norm(vertices - (gripper + hand) / 2, axis=1).min() < 1e-9
    assert scene.parts[scene.index("robot")].mesh.extent()[0, 2] == pytest.approx(-0.93)


def test_a_clip_is_rendered_once_and_read_back_unchanged(tmp_path):
    cameras = (small_camera((0.0, 1.5, 1.0), (1.0, 0.0, -0.3)), small_camera((0.0, -1.5, 1.0), (1.0, 0, -0.3), "right"))
    clip = Clip(Workspace(Cube()), cameras, np.array([0.0, 1 / 30]), HANDS, GRIPPERS, KinectNoise(), seed=4)
    first = list(clip.frames(tmp_path))
    (path,) = tmp_path.glob("*/*")
    written = path.stat().st_mtime_ns
    again = list(clip.frames(tmp_path))
    assert path.stat().st_mtime_ns == written
    for one, other in zip(sum(first, []), sum(again, []), strict=True):
        assert (one.name, one.time) == (other.name, other.time)
        assert all(np.array_equal(getattr(one, k), getattr(other, k)) for k in ("color", "depth", "valid"))
    assert not np.array_equal(first[0][0].depth, first[1][0].depth)


def test_whatever_changes_the_frames_changes_the_key():
    scene_of = dict(cameras=(small_camera(),), time=np.zeros(2), hands=HANDS, grippers=GRIPPERS)
    keys = {
        Clip(Workspace(Cube()), **scene_of).key(),
        Clip(Workspace(Cube(), thing_turn=0.1), **scene_of).key(),
        Clip(Workspace(Cube(), person=Person(stature=1.8)), **scene_of).key(),
        Clip(Workspace(Cube()), **scene_of, seed=1).key(),
        Clip(Workspace(Cube()), **scene_of, noise=KinectNoise(offset=0.01)).key(),
        Clip(Workspace(Cube()), **(scene_of | {"hands": HANDS + 0.001})).key(),
        Clip(Workspace(Cube()), **scene_of, lip=HANDS + 0.001).key(),
        Clip(Workspace(Cube()), **(scene_of | {"cameras": (small_camera((0.0, 1.0, 1.0)),)})).key(),
    }
    assert len(keys) == 8 and Clip(Workspace(Cube()), **scene_of).key() in keys
    assert two_boxes().index("red") == 1


@pytest.mark.parametrize("noise", [KinectNoise(), KinectNoise(step=0.0007)])
def test_a_clip_that_was_interrupted_goes_on_with_the_reel_that_is_missing(tmp_path, noise):
    camera, count = small_camera(), 32
    hands, grippers = (np.repeat(array[:1], count, axis=0) for array in (HANDS, GRIPPERS))
    clip = Clip(Workspace(Cube()), (camera,), np.arange(count) / 30, hands, grippers, noise)
    for _, _ in zip(range(30), clip.frames(tmp_path), strict=False):
        pass
    (path,) = tmp_path.glob("*/*")
    written = path.stat().st_mtime_ns
    resumed = list(clip.frames(tmp_path))
    assert path.stat().st_mtime_ns == written and len(list(tmp_path.glob("*/*"))) == 2
    whole = [*clip.render(0), *clip.render(30)]
    assert len(resumed) == len(whole) == count
    for (one,), (other,) in zip(resumed, whole, strict=True):
        assert one.time == other.time and one.depth.dtype == np.float32
        assert all(np.array_equal(getattr(one, k), getattr(other, k)) for k in ("color", "depth", "valid"))
    # the noise of a reel is its own
    assert not np.array_equal(whole[0][0].depth, whole[30][0].depth)
