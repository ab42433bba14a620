from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.errors import InputError, ShapeError
from eaip_prob.recording import Moment, NullLogger, RerunLogger
from eaip_prob.recording.rerun_scene import straightened_boxes, vertex_normals
from eaip_prob.recording.rerun_sensors import squared

LENS = Intrinsics(96, 54, 53.0, 50.0, 47.0, 26.0, (0.05, -0.07, 0.0, 0.0, 0.0))
AT, LATER, LAST = Moment(2, 0.25), Moment(5, 0.5), Moment(9, 0.75)
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
# A tetrahedron; every triangle is seen from outside counter-clockwise.
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
COLORS = np.array([[250, 0, 0], [0, 250, 0], [0, 0, 250], [9, 9, 9]], np.uint8)


def rows(path: Path, entity: str, component: str) -> list[tuple[tuple[float, int] | None, Any]]:
    found: list[tuple[tuple[float, int] | None, Any]] = []
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        when: list[Any] = [None] * batch.num_rows
        if not chunk.is_static:
            seconds = batch.column("time").cast("int64").to_numpy() * 1e-9
            when = list(zip(seconds.round(9).tolist(), batch.column("samples_seen").to_pylist(), strict=True))
        found += [it for it in zip(when, batch.column(component).to_pylist(), strict=True) if it[1] is not None]
    return found


def views(path: Path) -> dict[str, list[str]]:
    """Contents of the views of the last layout, by name."""
    reader, layouts = RrdReader(path), []
    for store in reader.blueprints():
        found: dict[str, dict[str, Any]] = {}
        for chunk in reader.stream(store=store).to_chunks():
            batch = chunk.to_record_batch()
            entity = chunk.entity_path.removesuffix("/ViewContents")
            for name in ("display_name", "query"):
                for column in (it for it in batch.schema.names if it.endswith(f":{name}")):
                    found.setdefault(entity, {})[name] = batch.column(column).to_pylist()[0]
        layouts.append({it["display_name"][0]: it["query"] for it in found.values() if len(it) == 2})
    return max(layouts, key=lambda layout: sum(len(contents) for contents in layout.values()))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "recording.rrd"


@pytest.fixture(params=["null", "rerun"])
def logger(request, path):
    with NullLogger() if request.param == "null" else RerunLogger(path) as made:
        yield made


def test_every_call_is_accepted(logger):
    logger.blueprint("workspace", {"a": "a [m]"}, timeline="time")
    logger.mesh("thing", CORNERS, FACES, COLORS, at=AT)
    logger.mesh("cloth", CORNERS.tolist(), FACES.tolist(), (1, 2, 3), smooth=True)
    logger.image_boxes("camera", [[9.0, 9.0, 4.0, 2.0]], LENS, color=(1, 2, 3, 4), labels=["chair"], at=AT)
    logger.image_boxes("camera", np.zeros((0, 4)), LENS, at=LATER)


def test_flat_triangles_have_corners_colours_and_normals_of_their_own(path):
    with RerunLogger(path) as logger:
        logger.mesh("thing", CORNERS, FACES, COLORS, at=AT)
    ((_, positions),) = rows(path, "/space/thing", "Mesh3D:vertex_positions")
    ((_, normals),) = rows(path, "/space/thing", "Mesh3D:vertex_normals")
    ((_, triangles),) = rows(path, "/space/thing", "Mesh3D:triangle_indices")
    ((_, colors),) = rows(path, "/space/thing", "Mesh3D:vertex_colors")
    corners = np.array(positions)[np.array(triangles)]
    np.testing.assert_allclose(corners, CORNERS[FACES])
    for face in range(4):
        directions = np.array(normals)[triangles[face]]
        outward = corners[face].mean(0) - CORNERS.mean(0)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-6)
        assert (directions @ outward > 0).all()
        np.testing.assert_allclose(directions @ (corners[face][1] - corners[face][0]), 0.0, atol=1e-6)
        assert [colors[vertex] for vertex in triangles[face]] == [
            int.from_bytes([*COLORS[face].tolist(), 255]) for _ in range(3)
        ]


def test_smooth_surfaces_share_vertices_and_average_by_area(path):
    with RerunLogger(path) as logger:
        logger.mesh("cloth", CORNERS, FACES, (200, 100, 50), smooth=True, at=AT)
    ((when, positions),) = rows(path, "/space/cloth", "Mesh3D:vertex_positions")
    assert when == (0.25, 2)
    np.testing.assert_allclose(positions, CORNERS)
    ((_, normals),) = rows(path, "/space/cloth", "Mesh3D:vertex_normals")
    # The corner at the origin has three equal faces; that on x two of area 1/2 and the large one of sqrt(3) / 2.
    np.testing.assert_allclose(normals[0], -np.ones(3) / np.sqrt(3), atol=1e-6)
    faces = np.array([[0, 0, -1.0], [0, -1.0, 0], [1.0, 1.0, 1.0]]).sum(0)
    np.testing.assert_allclose(normals[1], faces / np.linalg.norm(faces), atol=1e-6)
    ((_, colors),) = rows(path, "/space/cloth", "Mesh3D:vertex_colors")
    assert colors == [0xC86432FF] * 4


def test_a_vertex_of_no_triangle_has_no_normal():
    assert vertex_normals(np.vstack([CORNERS, [9.0, 9.0, 9.0]]), FACES)[4].tolist() == [0.0, 0.0, 0.0]


def test_only_vertices_are_stored_again_where_only_they_change(path):
    with RerunLogger(path) as logger:
        logger.mesh("bag", CORNERS, FACES, (1, 2, 3), smooth=True, at=AT)
        logger.mesh("bag", 2.0 * CORNERS, FACES, (1, 2, 3), smooth=True, at=LATER)
        logger.mesh("bag", CORNERS, FACES[::-1], (1, 2, 3), smooth=True, at=LAST)
        logger.mesh("other", CORNERS, FACES, (1, 2, 3), smooth=True, at=LAST)
    times = [when for when, _ in rows(path, "/space/bag", "Mesh3D:vertex_positions")]
    assert times == [(0.25, 2), (0.5, 5), (0.75, 9)]
    assert [when for when, _ in rows(path, "/space/bag", "Mesh3D:triangle_indices")] == [(0.25, 2), (0.75, 9)]
    assert len(rows(path, "/space/other", "Mesh3D:triangle_indices")) == 1


def test_boxes_hold_what_they_held_before_the_image_was_straightened(path):
    box = np.array([80.0, 40.0, 20.0, 16.0])
    with RerunLogger(path) as logger:
        logger.image_boxes("cameras/right", box[None], LENS, labels=["chair 0.93"], at=AT)
        logger.image_boxes("cameras/right", np.zeros((0, 4)), LENS, at=LATER)
    entity = "/space/cameras/right/color_camera/boxes"
    (_, (center,)), (_, gone) = rows(path, entity, "Boxes2D:centers")
    ((_, (half,)), _) = rows(path, entity, "Boxes2D:half_sizes")
    assert gone == []
    assert rows(path, entity, "Boxes2D:labels") == [((0.25, 2), ["chair 0.93"])]
    # Where the whole rim of the box goes, point by point, in an image with one focal length; pixels from the corner.
    share = np.linspace(-0.5, 0.5, 201)
    rim = np.concatenate(
        [np.stack([share, np.full(201, end)], -1)[:, order] for end in (-0.5, 0.5) for order in ([0, 1], [1, 0])]
    )
    rays = LENS.unproject(box[:2] + rim * box[2:], np.ones(len(rim)))
    straight = rays[:, :2] * 53.0 + [47.0, 26.0] + 0.5
    np.testing.assert_allclose(np.subtract(center, half), straight.min(0), atol=0.02)
    np.testing.assert_allclose(np.add(center, half), straight.max(0), atol=0.02)
    assert np.abs(straight.max(0) - (box[:2] + box[2:] / 2.0 + 0.5)).max() > 1.0  # it matters


def test_boxes_of_a_lens_without_distortion_stay_where_they_are():
    plain = Intrinsics(96, 54, 53.0, 53.0, 47.0, 26.0)
    low, high = straightened_boxes(np.array([[30.0, 20.0, 8.0, 6.0]]), plain)
    np.testing.assert_allclose([low[0], high[0]], [[26.0, 17.0], [34.0, 23.0]])


def test_colour_is_shown_with_one_focal_length(path):
    """The viewer draws no boxes over a camera with two."""
    depth = np.full((54, 96), 1.5, np.float32)
    color = np.zeros((54, 96, 3), np.uint8)
    color[40:] = 255  # a level edge, 14 rows below the axis of a lens without distortion
    lens = replace(LENS, distortion=(0.0,) * 5)
    frame = RGBDFrame(color, depth, depth > 0, lens, np.eye(4), 0.25, name="right")
    with RerunLogger(path) as logger:
        logger.camera("cameras/right", frame, at=AT)
    ((_, (matrix,)),) = rows(path, "/space/cameras/right/color_camera", "Pinhole:image_from_camera")
    assert (matrix[0], matrix[4]) == (53.0, 53.0)
    ((_, (blob,)),) = rows(path, "/space/cameras/right/color_camera/color", "EncodedImage:blob")
    import cv2

    shown = cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    edge = int(np.argmax(shown[:, 48, 0] > 127))
    assert edge == round(26.0 + 13.5 * 53.0 / 50.0 + 0.5)
    assert squared(LENS).distortion == (0.0,) * 5


def test_the_layout_keeps_clouds_from_surfaces_and_shows_every_image(path):
    depth = np.full((54, 96), 1.5, np.float32)
    frame = RGBDFrame(np.zeros((54, 96, 3), np.uint8), depth, depth > 0, LENS, np.eye(4), 0.25, name="right")
    with RerunLogger(path) as logger:
        logger.blueprint("workspace", {"risk": "risk"}, timeline="time")
        logger.camera("cameras/right", frame, at=AT)
        logger.mesh("bag", CORNERS, FACES, at=AT)
        logger.cloud("cloud", CORNERS, COLORS, at=AT)
    found = views(path)
    assert {"right: colour", "Report", "risk"} <= set(found)
    scene, seen = found["Workspace [m], z up"], found["Seen by the cameras [m], z up"]
    assert "- /space/cloud" in scene and "- /space/bag" not in scene
    assert "- /space/bag" in seen and "- /space/cloud" not in seen
    assert "- /space/cameras/right/color_camera/boxes" in scene


REFUSALS = [
    (ShapeError, r"vertices with shape \(any, 3\) at 'a', got \(4, 2\)", lambda r: r.mesh("a", CORNERS[:, :2], FACES)),
    (ShapeError, r"triangles with shape \(any, 3\)", lambda r: r.mesh("a", CORNERS, np.zeros((0, 3)))),
    (
        InputError,
        "vertices 0 to 3 at 'a', got indices from 0 to 4",
        lambda r: r.mesh("a", CORNERS, FACES + [[0, 1, 1]]),
    ),
    (InputError, "vertices 0 to 3", lambda r: r.mesh("a", CORNERS, FACES - 1)),
    (InputError, "vertices 0 to 3", lambda r: r.mesh("a", CORNERS, FACES / 2)),
    (InputError, "finite numbers in vertices", lambda r: r.mesh("a", np.full((4, 3), np.nan), FACES)),
    (ShapeError, r"colors with shape \(4, 3\) or one color", lambda r: r.mesh("a", CORNERS, FACES, COLORS[:2])),
    (InputError, "colors as uint8.*float64", lambda r: r.mesh("a", CORNERS, FACES, COLORS / 255)),
    (InputError, r"whole numbers 0\.\.255", lambda r: r.mesh("a", CORNERS, FACES, (300, 0, 0))),
    (InputError, "got 'a b'", lambda r: r.mesh("a b", CORNERS, FACES)),
    (ShapeError, r"boxes with shape \(N, 4\) at 'a', got \(4,\)", lambda r: r.image_boxes("a", [1, 1, 1, 1], LENS)),
    (InputError, "widths and heights above zero", lambda r: r.image_boxes("a", [[1, 1, 0, 1]], LENS)),
    (ShapeError, "1 labels at 'a', or none, got 2", lambda r: r.image_boxes("a", [[1, 1, 1, 1]], LENS, labels="bc")),
]


@pytest.mark.parametrize(("error", "message", "call"), REFUSALS)
def test_refusals(logger, error, message, call):
    with pytest.raises(error, match=message):
        call(logger)
