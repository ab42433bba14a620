from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scene_world import from_conf

from eaip_prob.config import conf_dir
from eaip_prob.errors import DataFileError, InputError, MissingDataError
from eaip_prob.simulation import MeshFile, Part, Scene, box

OBJECTS = sorted(path.stem for path in (conf_dir() / "object").glob("*.yaml"))


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_stands_on_the_floor_with_the_dimensions_of_its_file(name):
    thing = from_conf(f"object/{name}")
    low, high = thing.mesh().extent()
    assert low[2] == pytest.approx(0.0, abs=0.015) and high[2] == pytest.approx(thing.height, abs=0.01)
    assert high[1] == pytest.approx(-low[1]) and 2 * high[1] == pytest.approx(thing.width, abs=0.15)


@pytest.mark.parametrize("name", OBJECTS)
def test_width_and_height_change_the_mesh(name):
    thing = from_conf(f"object/{name}")
    wide, tall = (dataclasses.replace(thing, **{key: getattr(thing, key) + 0.2}) for key in ("width", "height"))
    size = np.ptp(thing.mesh().extent(), axis=0)
    assert np.ptp(wide.mesh().extent(), axis=0) - size == pytest.approx([0, 0.2, 0], abs=0.09)
    assert np.ptp(tall.mesh().extent(), axis=0) - size == pytest.approx([0, 0, 0.2], abs=2e-3)


def test_every_object_is_in_one_of_the_two_lists():
    lists = [(conf_dir() / "objects" / f"{name}.yaml").read_text() for name in ("training", "novel")]
    assert all(sum(f"/object@{name}: {name}" in text for text in lists) == 1 for name in OBJECTS)
    assert len(OBJECTS) == 8 and [text.count("/object@") for text in lists] == [4, 4]


@pytest.mark.parametrize(("name", "front"), [("brown_bookshelf", 0.28), ("yellow_bookshelf", 0.29)])
def test_a_bookshelf_is_open_to_the_front(name, front):
    scene = Scene([Part("shelf", from_conf(f"object/{name}").mesh())])
    ray = np.array([[2.0, 0.0, 0.2, -1.0, 0.0, 0.0], [-2.0, 0.0, 0.2, 1.0, 0.0, 0.0]], np.float32)
    hits = scene.cast(ray)["t_hit"]
    assert hits[0] - hits[1] == pytest.approx(front, abs=0.02)


def test_a_dimension_of_zero_is_refused():
    with pytest.raises(InputError, match="width of Stepladder above zero, got 0"):
        dataclasses.replace(from_conf("object/stepladder"), width=0.0)


def test_a_mesh_file_is_set_on_the_floor(tmp_path):
    open3d = pytest.importorskip("open3d")
    mesh = open3d.geometry.TriangleMesh.create_box(200.0, 400.0, 600.0).translate((1000.0, 50.0, -70.0))
    path = tmp_path / "thing.ply"
    open3d.io.write_triangle_mesh(str(path), mesh)
    thing = MeshFile(str(path), scale=0.001, color=(0.2, 0.4, 0.6)).mesh()
    assert thing.extent().tolist() == [pytest.approx([-0.1, -0.2, 0.0]), pytest.approx([0.1, 0.2, 0.6])]
    assert thing.color[0] == pytest.approx([0.2, 0.4, 0.6])
    mesh.paint_uniform_color((1.0, 0.0, 0.0))
    open3d.io.write_triangle_mesh(str(path), mesh)
    assert MeshFile(str(path)).mesh().color[0] == pytest.approx([1.0, 0.0, 0.0])


def test_a_missing_or_empty_mesh_file_is_refused(tmp_path):
    with pytest.raises(MissingDataError, match="no such file"):
        MeshFile(str(tmp_path / "none.ply")).mesh()
    (tmp_path / "empty.ply").write_bytes(b"")
    with pytest.raises(DataFileError, match="got 0 triangles"):
        MeshFile(str(tmp_path / "empty.ply")).mesh()
    with pytest.raises(InputError, match="scale of MeshFile above zero"):
        MeshFile("a.ply", scale=0.0)
    assert box((1, 1, 1), (0, 0, 0)).extent()[0].tolist() == [-0.5] * 3
