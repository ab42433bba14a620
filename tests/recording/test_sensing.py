from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.errors import InputError, NotPositiveDefiniteError, ShapeError
from eaip_prob.recording import Moment, NullLogger, RerunLogger
from eaip_prob.recording.rerun_sensors import straightened
from eaip_prob.recording.sensor_records import ellipsoid_axes

DEPTH = Intrinsics(40, 30, 30.0, 31.0, 18.0, 15.5, (0.09, -0.27, 0.001, 0.0, 0.1))
COLOR = Intrinsics(48, 27, 26.0, 26.5, 24.0, 13.0, (0.05, -0.07, 0.0, 0.0, 0.0))
AT, LATER = Moment(2, 0.25), Moment(5, 0.5)
TURN = Rotation.from_euler("xyz", [0.5, -0.8, 1.1]).as_matrix()
COVARIANCE = 1e-6 * np.array([TURN @ np.diag([1.0, 4.0, 25.0]) @ TURN.T, np.eye(3)])


def pose(seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(generator.normal(size=3)).as_matrix()
    T[:3, 3] = generator.normal(size=3)
    return T


def wall_frame(seed: int = 0, distance: float = 1.75, **changes: Any) -> RGBDFrame:
    """A wall across the axis of the depth camera, each of whose pixels has its own millimetres."""
    depth = np.full((30, 40), distance, np.float32) + np.arange(1200, dtype=np.float32).reshape(30, 40) * 1e-3
    color = np.zeros((27, 48, 3), np.uint8)
    color[:, :24] = [200, 40, 10]
    valid = np.ones((30, 40), bool)
    valid[15, 18] = False
    frame = RGBDFrame(color, depth, valid, DEPTH, pose(seed), 0.25, COLOR, pose(9), "left")
    return replace(frame, **changes)


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


def image(path: Path, entity: str, component: str) -> np.ndarray:
    ((when, (blob,)),) = rows(path, entity, component)
    assert when == (0.25, 2)
    decoded = cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    return decoded


@pytest.fixture
def path(tmp_path):
    return tmp_path / "recording.rrd"


def test_the_viewer_projects_depth_back_to_where_the_points_are(path):
    frame = wall_frame()
    with RerunLogger(path) as logger:
        logger.camera("cameras/left", frame, at=AT)
    root = "/space/cameras/left/depth_camera"
    ((_, (turn,)),) = rows(path, root, "Transform3D:quaternion")
    ((_, (shift,)),) = rows(path, root, "Transform3D:translation")
    ((_, (lens,)),) = rows(path, root, "Pinhole:image_from_camera")
    ((_, (meter,)),) = rows(path, f"{root}/depth", "EncodedDepthImage:meter")
    assert rows(path, root, "Pinhole:resolution")[0][1] == [[40.0, 30.0]]
    depth = image(path, f"{root}/depth", "EncodedDepthImage:blob")
    K = np.reshape(lens, (3, 3)).T  # rerun stores columns one after another
    row, column = np.nonzero(depth)
    z = depth[row, column] / meter
    seen = np.column_stack([(column - K[0, 2]) / K[0, 0] * z, (row - K[1, 2]) / K[1, 1] * z, z])
    world = seen @ Rotation.from_quat(turn).as_matrix().T + shift
    # each point has its own millimetres: compare with the pixel that measured them, half a pixel away at most
    measured = frame.depth[frame.valid].tolist()
    known = {round(1000 * value): point for value, point in zip(measured, frame.points(), strict=True)}
    distance = [np.linalg.norm(point - known[round(value * 1000)]) for value, point in zip(z, world, strict=True)]
    # a pixel is 0.1 m wide at 3 m, and a straight image may take its neighbour across a corner; distortion: 0.14 m
    assert len(distance) > 1000
    assert max(distance) < 0.5 * np.sqrt(2) * 3.0 / 30.0 * 1.15
    assert depth[15, 18] == 0  # next to the axis, where distortion moves nothing


def test_colour_stands_where_the_colour_camera_does(path):
    frame = wall_frame()
    with RerunLogger(path) as logger:
        logger.camera("cameras/left", frame, at=AT)
    root = "/space/cameras/left/color_camera"
    ((_, (turn,)),) = rows(path, root, "Transform3D:quaternion")
    ((_, (shift,)),) = rows(path, root, "Transform3D:translation")
    T_world_color = np.eye(4)
    T_world_color[:3, :3], T_world_color[:3, 3] = Rotation.from_quat(turn).as_matrix(), shift
    assert frame.T_color_depth is not None
    np.testing.assert_allclose(T_world_color @ frame.T_color_depth, frame.T_world_camera, atol=1e-6)
    assert rows(path, root, "Pinhole:resolution")[0][1] == [[48.0, 27.0]]
    color = image(path, f"{root}/color", "EncodedImage:blob")
    np.testing.assert_allclose(color[13, 5], [10, 40, 200], atol=8)  # OpenCV reads blue first
    np.testing.assert_allclose(color[13, 40], 0, atol=8)


def test_registered_colour_stands_where_depth_does(path):
    color = np.full((30, 40, 3), 90, np.uint8)
    with RerunLogger(path) as logger:
        logger.camera("top", wall_frame(color=color, color_intrinsics=None, T_color_depth=None), at=AT)
    places = [rows(path, f"/space/top/{which}_camera", "Transform3D:translation")[0][1] for which in ("depth", "color")]
    assert places[0] == places[1]
    assert image(path, "/space/top/color_camera/color", "EncodedImage:blob").shape == (30, 40, 3)


def test_a_camera_is_placed_again_only_when_it_moved(path):
    with RerunLogger(path) as logger:
        logger.camera("a", wall_frame(), at=AT)
        logger.camera("a", wall_frame(distance=2.0), at=Moment(3, 0.3))
        logger.camera("b", wall_frame(), at=LATER)
        logger.camera("a", wall_frame(seed=4), at=LATER)
    moved = rows(path, "/space/a/depth_camera", "Transform3D:translation")
    assert [when for when, _ in moved] == [(0.25, 2), (0.5, 5)]
    np.testing.assert_allclose(moved[1][1][0], pose(4)[:3, 3], atol=1e-6)
    assert len(rows(path, "/space/a/depth_camera", "Pinhole:resolution")) == 2
    assert len(rows(path, "/space/a/depth_camera/depth", "EncodedDepthImage:blob")) == 3
    assert len(rows(path, "/space/b/color_camera", "Pinhole:resolution")) == 1


def test_straight_lines_are_straight():
    lens = replace(DEPTH, distortion=(-0.25, 0.0, 0.0, 0.0, 0.0))
    row, column = np.mgrid[0:30, 0:40]
    rays = lens.unproject(np.stack([column, row], -1).astype(float), np.ones((30, 40)))
    taken = np.where(rays[..., 0] > 0.5, 255, 0).astype(np.uint8)  # an upright edge
    bent, edge = (np.argmax(it > 0, axis=1) for it in (taken, straightened(taken, lens, cv2.INTER_NEAREST)))
    assert np.ptp(bent) == 2
    assert set(edge) <= {33, 34}  # column 33 is x / z = 0.5, half a pixel before the first that is more
    assert straightened(taken, replace(lens, distortion=(0.0,) * 5), cv2.INTER_NEAREST) is taken


def test_clouds_have_packed_colours_and_may_be_empty(path):
    points = np.array([[0.1, 0.2, 0.3], [-1.0, 0.5, 2.0]])
    colors = np.array([[1, 2, 3], [250, 128, 7]], np.uint8)
    with RerunLogger(path) as logger:
        logger.cloud("cloud", points, colors, radius=0.004, at=AT)
        logger.cloud("cloud", np.zeros((0, 3)), np.zeros((0, 3), np.uint8), at=LATER)
    first, second = rows(path, "/space/cloud", "Points3D:positions")
    assert (first[0], second) == ((0.25, 2), ((0.5, 5), []))
    np.testing.assert_allclose(first[1], points, rtol=1e-6)
    assert rows(path, "/space/cloud", "Points3D:colors")[0] == ((0.25, 2), [0x010203FF, 0xFA8007FF])
    np.testing.assert_allclose(rows(path, "/space/cloud", "Points3D:radii")[0][1], [0.004], rtol=1e-6)


def test_markers_are_as_large_at_any_distance(path):
    with RerunLogger(path) as logger:
        logger.points("hands", [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], radius=2.5, labels=["left", "right"], at=AT)
        logger.points("goal", [[0.0, 0.0, 1.0]], color=(1, 2, 3))
    assert rows(path, "/space/hands", "Points3D:positions") == [((0.25, 2), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])]
    assert rows(path, "/space/hands", "Points3D:radii") == [((0.25, 2), [-2.5])]
    assert rows(path, "/space/hands", "Points3D:labels") == [((0.25, 2), ["left", "right"])]
    assert rows(path, "/space/goal", "Points3D:colors") == [(None, [0x010203FF])]
    assert rows(path, "/space/goal", "Points3D:labels") == []


def test_ellipsoids_in_the_file_hold_their_share_of_draws(path):
    centers = np.array([[1.0, 2.0, 3.0], [-1.0, 0.0, 0.5]])
    with RerunLogger(path) as logger:
        logger.ellipsoids("hands", centers, COVARIANCE, level=0.8, labels=["a", "b"], at=AT)
    names = ("half_sizes", "quaternions", "centers")
    sizes, turns, found = (rows(path, "/space/hands", f"Ellipsoids3D:{name}")[0][1] for name in names)
    np.testing.assert_allclose(found, centers)
    assert rows(path, "/space/hands", "Ellipsoids3D:labels") == [((0.25, 2), ["a", "b"])]
    generator = np.random.default_rng(5)
    for k in range(2):
        draws = generator.multivariate_normal(centers[k], COVARIANCE[k], size=20_000)
        local = (draws - centers[k]) @ Rotation.from_quat(turns[k]).as_matrix()  # into the axes of the ellipsoid
        share = float(((local / sizes[k]) ** 2).sum(-1).__le__(1.0).mean())
        assert abs(share - 0.8) < 4 * np.sqrt(0.8 * 0.2 / 20_000)


def test_axes_give_the_covariance_back_and_are_right_handed():
    sizes, rotations = ellipsoid_axes(COVARIANCE, level=0.95)
    np.testing.assert_allclose([np.cross(r[:, 0], r[:, 1]) @ r[:, 2] for r in rotations], 1.0)
    radius = sizes[1, 0] / 1e-3  # of the ball that holds 95 % of a standard Gaussian: 2.7955
    np.testing.assert_allclose(radius, 2.7955, atol=1e-4)
    for k in range(2):
        rebuilt = rotations[k] @ np.diag((sizes[k] / radius) ** 2) @ rotations[k].T
        np.testing.assert_allclose(rebuilt, COVARIANCE[k], atol=1e-16)


COLORS = np.zeros((2, 3), np.uint8)
ONE = np.eye(3)[None]
REFUSALS = [
    (InputError, "RGBDFrame at 'a', got ndarray", lambda r: r.camera("a", np.zeros((4, 4)))),
    (InputError, "entity such as .* got 'a b'", lambda r: r.camera("a b", wall_frame())),
    (ShapeError, r"points with shape \(N, 3\) at 'a', got \(2, 2\)", lambda r: r.cloud("a", [[0, 0], [1, 1]], COLORS)),
    (ShapeError, r"colors with shape \(1, 3\).*got \(2, 3\)", lambda r: r.cloud("a", [[0, 0, 0]], COLORS)),
    (InputError, "colors as uint8.*float64", lambda r: r.cloud("a", np.zeros((2, 3)), COLORS / 255)),
    (InputError, "finite numbers in points", lambda r: r.cloud("a", np.full((2, 3), np.nan), COLORS)),
    (InputError, "radius above zero", lambda r: r.cloud("a", np.zeros((2, 3)), COLORS, radius=0.0)),
    (ShapeError, r"positions with shape \(N, 3\).*got \(3,\)", lambda r: r.points("a", [0, 0, 0])),
    (ShapeError, r"positions with shape \(N, 3\).*got \(1, 2\)", lambda r: r.points("a", [[0, 0]])),
    (ShapeError, "1 labels at 'a', or none, got 2", lambda r: r.points("a", [[0, 0, 0]], labels=["b", "c"])),
    (InputError, "radius above zero", lambda r: r.points("a", [[0, 0, 0]], radius=-2.0)),
    (ShapeError, r"covariance with shape \(1, 3, 3\).*\(3, 3\)", lambda r: r.ellipsoids("a", [[0, 0, 0]], np.eye(3))),
    (ShapeError, "1 labels", lambda r: r.ellipsoids("a", [[0, 0, 0]], ONE, labels=["b", "c"])),
    (InputError, "level above 0 and below 1 at 'a', got 1", lambda r: r.ellipsoids("a", [[0, 0, 0]], ONE, level=1.0)),
    (InputError, "symmetric", lambda r: r.ellipsoids("a", [[0, 0, 0]], ONE + np.eye(3, k=1))),
    (NotPositiveDefiniteError, "got -1", lambda r: r.ellipsoids("a", [[0, 0, 0]], np.diag([1.0, -1.0, 1.0])[None])),
    (InputError, r"whole numbers 0\.\.255", lambda r: r.ellipsoids("a", [[0, 0, 0]], ONE, color=(300, 0, 0))),
]


@pytest.mark.parametrize(("error", "message", "call"), REFUSALS)
@pytest.mark.parametrize("kind", [NullLogger, RerunLogger])
def test_refusals(path, kind, error, message, call):
    with kind(path) as logger, pytest.raises(error, match=message):
        call(logger)


def record(path: Path, seed: int = 3) -> Path:
    generator = np.random.default_rng(seed)
    with RerunLogger(path, "test") as logger:
        logger.blueprint("cameras", {"errors": "error [mm]"}, timeline="time")
        for moment in (AT, LATER):
            depth = generator.uniform(0.5, 4.0, size=(30, 40)).astype(np.float32)
            logger.camera("cameras/left", wall_frame(depth=depth), at=moment)
            logger.cloud("cloud", generator.normal(size=(9, 3)), np.full((9, 3), 80, np.uint8), at=moment)
            logger.points("hand", generator.normal(size=(1, 3)), at=moment)
            logger.ellipsoids("hand/ellipsoid", np.zeros((2, 3)), COVARIANCE, at=moment)
        logger.series("errors", [0.25, 0.5], [[1.0], [2.0]], ["left"])
    return path


def contents(path: Path) -> list[Any]:
    chunks = RrdReader(path).stream().to_chunks()
    return [(chunk.entity_path, chunk.to_record_batch().drop_columns(["rerun.controls.RowId"])) for chunk in chunks]


def test_one_seed_gives_equal_recordings(tmp_path):
    one, same = contents(record(tmp_path / "a.rrd")), contents(record(tmp_path / "b.rrd"))
    assert len(one) > 10
    assert one == same
    assert one != contents(record(tmp_path / "c.rrd", seed=4))


def views(path: Path) -> dict[str, tuple[str, list[str]]]:
    """(origin, contents) of the views, by name, of the layout that has most to show: the last."""
    reader, layouts = RrdReader(path), []
    for store in reader.blueprints():
        found: dict[str, dict[str, Any]] = {}
        for chunk in reader.stream(store=store).to_chunks():
            batch = chunk.to_record_batch()
            entity = chunk.entity_path.removesuffix("/ViewContents")
            for name in ("display_name", "space_origin", "query"):
                for column in (it for it in batch.schema.names if it.endswith(f":{name}")):
                    found.setdefault(entity, {})[name] = batch.column(column).to_pylist()[0]
        shown = [it for it in found.values() if "space_origin" in it]
        layouts.append({it["display_name"][0]: (it["space_origin"][0], it["query"]) for it in shown})
    return max(layouts, key=lambda layout: sum(len(contents) for _, contents in layout.values()))


def test_the_layout_shows_each_camera_and_keeps_clouds_from_depth(path):
    found = views(record(path))
    assert {"left: colour", "left: depth", "Report", "error [mm]"} <= set(found)
    assert found["left: colour"] == ("/space/cameras/left/color_camera", ["+ $origin/**", "+ /space/hand"])
    assert found["left: depth"][0] == "/space/cameras/left/depth_camera"
    origin, workspace = found["Workspace [m], z up"]
    assert origin == "/space" and "- /space/cameras/left/depth_camera/depth" in workspace
    assert "- /space/cloud" not in workspace
    assert "- /space/cloud" in found["Depth images in space [m], z up"][1]
    assert {"- /space/cloud", "- /space/cameras/left/**"} <= set(found["Markers alone [m], z up"][1])


def test_a_layout_without_cameras_or_plots_opens_as_well(path):
    with RerunLogger(path) as logger:
        logger.blueprint("cameras")
    assert set(views(path)) == {
        "Workspace [m], z up",
        "Depth images in space [m], z up",
        "Markers alone [m], z up",
        "Report",
    }
