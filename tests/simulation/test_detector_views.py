from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.data.frames import Intrinsics
from eaip_prob.detection.base import CLASSES
from eaip_prob.errors import InputError
from eaip_prob.simulation import Bookshelf, KinectModel, Part, Scene, View, box, render_depth
from eaip_prob.simulation.detector_views import DetectorViews, whole_box
from eaip_prob.simulation.varied_draw import Draw
from eaip_prob.simulation.varied_furniture import varied
from eaip_prob.simulation.varied_room import FLOOR, varied_lighting, varied_scene

SMALL = Intrinsics(96, 54, 53.0, 52.9, 47.4, 25.6, (0.054, -0.068, 0.0, 0.0, 0.0))
MODEL = KinectModel(SMALL, SMALL, (-0.05, 0.0, 0.0))
PLACE = (0.55, -1.75, 1.15), (0.95, 0.0, -0.15)


def views(num=4, seed=0, **changes):
    return DetectorViews(num, seed, MODEL, *PLACE, **changes)


@pytest.mark.parametrize("label", CLASSES)
def test_instances_stand_on_the_floor_and_differ(label):
    meshes = [varied(label, Draw(np.random.default_rng(seed))).mesh() for seed in range(20)]
    sizes = np.array([mesh.extent()[1] - mesh.extent()[0] for mesh in meshes])
    lowest = np.array([mesh.extent()[0, 2] for mesh in meshes])
    assert (np.abs(lowest) < 0.03).all() and (sizes > 0.1).all() and (sizes < 2.0).all()
    assert (sizes.std(0) / sizes.mean(0) > 0.08).all()
    again = varied(label, Draw(np.random.default_rng(0))).mesh()
    assert (again.vertices == meshes[0].vertices).all() and (again.color == meshes[0].color).all()


def test_unusual_lengths_are_never_usual():
    usual, odd = Draw(np.random.default_rng(0)), Draw(np.random.default_rng(0), unusual=True)
    inside = np.array([usual.length(0.2, 0.5) for _ in range(300)])
    outside = np.array([odd.length(0.2, 0.5) for _ in range(300)])
    assert (inside >= 0.2).all() and (inside <= 0.5).all()
    assert ((outside < 0.2) | (outside > 0.5)).all() and 0.1 < (outside < 0.2).mean() < 0.9
    assert (outside > 0.2 * 2.5**-0.21).all() and (outside < 0.5 * 2.5**0.21).all()


def test_no_usual_instance_has_a_combination_of_unusual_ones():
    usual, odd = Draw(np.random.default_rng(0)), Draw(np.random.default_rng(0), unusual=True)
    kinds = "abcde"
    trained = {(first, usual.matching(first, kinds)) for first in range(6) for _ in range(100)}
    kept = {(first, odd.matching(first, kinds)) for first in range(6) for _ in range(100)}
    assert len(trained) == 24 and len(kept) == 6 and not trained & kept
    assert {second for _, second in trained} == {second for _, second in kept} == set(kinds)


def test_nothing_but_the_back_tells_a_chair_from_a_table_of_the_same_plate_and_legs():
    plain = 0
    for seed in range(40):
        seat, plate = (
            varied(label, Draw(np.random.default_rng([seed, at])), Draw(np.random.default_rng(seed))).mesh()
            for at, label in enumerate(("chair", "table"))
        )
        common = min(len(seat.vertices), len(plate.vertices))
        same = (seat.vertices[:common] == plate.vertices[:common]).all(1)
        start = common if same.all() else int(same.argmin())
        assert start >= 24  # the plate, and at least two parts under it
        stand, top = plate.vertices[:start], plate.extent()[1, 2]
        assert stand[:, 2].max() == top and plate.vertices[start:, 2].max(initial=0.0) <= top + 1e-9
        assert seat.extent()[1, 2] > top + 0.18
        plain += len(plate.vertices) == start
    assert plain >= 4


def test_a_chair_and_a_table_side_by_side_are_often_pairs():
    plan, pairs = views(400), 0
    for group in range(100):
        chair, table = (
            plan._thing(name, group, np.random.default_rng([group, at]))[1].mesh().vertices[:8]
            for at, name in enumerate(("chair", "table"))
        )
        pairs += bool((chair == table).all())
    assert 25 < pairs < 55


def test_colours_tell_nothing_of_the_class():
    hues = {
        label: np.array([varied(label, Draw(np.random.default_rng(s))).mesh().color.mean(0) for s in range(60)])
        for label in CLASSES
    }
    means = np.array([hue.mean(0) for hue in hues.values()])
    spread = np.mean([hue.std(0) for hue in hues.values()])
    assert spread > 0.15 and np.abs(means - means.mean(0)).max() < 3.5 * spread / np.sqrt(60)


def test_the_box_is_of_the_whole_object_where_something_stands_before_it():
    thing = Part("thing", box((0.6, 0.4, 1.0), (1, 0, 0)).at(0.1, 0.2, 3.0))
    before = Part("before", box((0.3, 2.0, 0.1), (0, 1, 0)).at(0.3, 0.0, 1.5))
    view = View(SMALL, np.eye(4))
    visible, whole = whole_box(Scene([before, thing]), view)
    alone, same = whole_box(Scene([thing]), view)
    assert whole is not None and same is not None
    np.testing.assert_array_equal(whole, same)
    assert visible.sum() < 0.8 * alone.sum()
    rows, columns = np.nonzero(render_depth(Scene([thing]), view).hit)
    edges = np.concatenate([whole[:2] - whole[2:] / 2, whole[:2] + whole[2:] / 2])
    np.testing.assert_allclose(
        edges, [columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5], atol=1.0
    )


def test_objects_that_are_hidden_or_outside_are_left_out():
    thing = box((0.6, 0.4, 1.0), (1, 0, 0))
    wall = Part("wall", box((4.0, 4.0, 0.1), (0, 1, 0)).at(z=1.0))
    view = View(SMALL, np.eye(4))
    assert whole_box(Scene([Part("thing", thing.at(z=3.0)), wall]), view)[1] is None
    assert whole_box(Scene([Part("thing", thing.at(2.7, 0.0, 3.0))]), view)[1] is None
    assert whole_box(Scene([Part("thing", thing.at(z=-3.0))]), view)[1] is None
    cut = whole_box(Scene([Part("thing", thing.at(2.2, 0.0, 3.0))]), view)[1]
    assert cut is not None and cut[0] + cut[2] / 2 <= 95.5 + 1e-9


def test_rooms_differ_and_the_object_stands_in_them():
    thing, names, places = varied("table", Draw(np.random.default_rng(0))), [], []
    for seed in range(12):
        scene = varied_scene(thing, Draw(np.random.default_rng(seed)))
        extent = scene.parts[scene.index("thing")].mesh.extent()
        assert abs(extent[0, 2] - FLOOR) < 0.03
        names.append(tuple(part.name for part in scene.parts))
        places.append(extent.mean(0)[:2])
    assert np.ptp(np.array(places), axis=0).min() > 0.2
    assert any("bag" in these for these in names) and any("bag" not in these for these in names)
    assert varied_lighting(Draw(np.random.default_rng(0))) != varied_lighting(Draw(np.random.default_rng(1)))


def test_a_view_is_its_own_whatever_else_is_rendered():
    one, other = views(4).render(2), views(9).render(2)
    assert (one.image == other.image).all() and (one.box == other.box).all()
    assert one.names == ["table"] and one.image.shape == (1, 54, 96, 3) and one.image.std() > 5
    x, y = one.box[0, :2].astype(int)
    assert one.visible[0, max(y - 9, 0) : y + 9, x - 9 : x + 9].any()
    assert (views(4, seed=1).render(2).image != one.image).any()


def test_some_views_show_the_demonstrated_piece_in_other_colours():
    piece = Bookshelf(0.6, 0.29, 0.9, 2, 0.02, (0.42, 0.26, 0.15), (0.34, 0.21, 0.13))
    plan = views(40, pieces={"bookshelf": piece})
    own, meshes = piece.mesh(), []
    for index in range(200):
        label, thing = plan._thing("bookshelf", 0, np.random.default_rng(index))
        mesh = thing.mesh()
        if mesh.vertices.shape == own.vertices.shape:
            factors = mesh.extent()[1] / own.extent()[1]
            if np.allclose(mesh.vertices, own.vertices * factors):
                meshes.append(mesh)
                assert label == "bookshelf" and (np.abs(np.log(factors)) < np.log(1.1)).all()
    assert 40 < len(meshes) < 85
    assert len({tuple(mesh.color[0]) for mesh in meshes}) == len(meshes)
    assert len(np.unique(meshes[0].color, axis=0)) == len(np.unique(own.color, axis=0))


def test_views_are_kept_on_disk(tmp_path, monkeypatch):
    made = views(4).views(tmp_path)
    assert made.names == list(CLASSES) and len(list(tmp_path.iterdir())) == 1
    monkeypatch.setattr(DetectorViews, "render", None)
    kept = views(4).views(tmp_path)
    for name in vars(made):
        np.testing.assert_array_equal(getattr(made, name), getattr(kept, name))


def test_every_setting_changes_the_file():
    shelf = {"shelf": ("bookshelf", Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1)))}
    red = {"shelf": ("bookshelf", Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.9, 0.25, 0.15), (0.3, 0.2, 0.1)))}
    changes = [{}, {"num": 5}, {"seed": 1}, {"unusual": True}, {"jitter": 0.1}, {"things": shelf}, {"things": red}]
    changes += [{"pieces": {"bookshelf": shelf["shelf"][1]}}, {"pieces": {"bookshelf": red["shelf"][1]}}]
    keys = {views(**change).key() for change in changes}
    assert len(keys) == len(changes) and views().key() in keys


def test_bad_plans_are_refused():
    with pytest.raises(InputError, match="at least one view"):
        views(0)
    with pytest.raises(InputError, match="'sofa'"):
        views(things={"a": ("sofa", Bookshelf(0.4, 0.3, 0.9, 2, 0.018, (0.4, 0.25, 0.15), (0.3, 0.2, 0.1)))})
    with pytest.raises(InputError, match="among"):
        varied("sofa", Draw(np.random.default_rng(0)))
    away = DetectorViews(1, 0, MODEL, PLACE[0], (0.95, -9.0, -0.15))
    with pytest.raises(InputError, match="in view of a camera"):
        away.render(0)
