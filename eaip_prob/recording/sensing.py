"""The calls that record what cameras saw, and what was made of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from eaip_prob.data.frames import Intrinsics, RGBDFrame
from eaip_prob.recording.checks import Color
from eaip_prob.recording.drawing import AbstractDrawing
from eaip_prob.recording.records import PREDICTED, SCENE, TRUTH, Moment
from eaip_prob.recording.scene_records import ImageBoxes, Surface
from eaip_prob.recording.sensor_records import CameraImages, Cloud, Ellipsoids, Markers


class AbstractSensing(AbstractDrawing):
    """Cameras with boxes in their images, clouds, surfaces, markers and covariances, all in space, m, z up."""

    def camera(self, entity: str, frame: RGBDFrame, *, at: Moment | None = None) -> None:
        """Depth and colour of one camera, which the viewer projects back into space.

        Depth is kept in whole millimetres and colour as JPEG. The viewer knows no lens distortion, so both images are
        straightened, pixel for pixel, to those of a pinhole camera with the same focal length and principal point, of
        colour with the horizontal focal length for both directions. What changes from moment to moment is stored for
        each; where the camera stands and its lenses only when they change.

        Args:
            entity: name of the camera, such as `cameras/left`.
            frame: what it saw; distances beyond 65.5 m cannot occur.
            at: since when the images hold, until the next ones; None for the whole recording.

        Example:
            >>> import numpy as np
            >>> from eaip_prob.data.frames import Intrinsics, RGBDFrame
            >>> from eaip_prob.recording import NullLogger
            >>> lens, depth = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0), np.full((3, 4), 2.0, dtype=np.float32)
            >>> frame = RGBDFrame(np.zeros((3, 4, 3), np.uint8), depth, depth > 0, lens, np.eye(4), 0.1)
            >>> NullLogger().camera("cameras/left", frame, at=Moment(3, frame.time))
        """
        self._record(CameraImages(entity, frame, at))

    def cloud(self, entity: str, points: Any, colors: Any, *, radius: float = 0.005, at: Moment | None = None) -> None:
        """Points of surfaces, each with its colour.

        Args:
            entity: name of the cloud, such as `cloud`.
            points: (N, 3), in the world, m; N may be 0, where nothing is seen.
            colors: (N, 3), uint8, RGB.
            radius: of a point, m.
            at: since when the cloud holds, until the next one; None for the whole recording.

        Example:
            >>> import numpy as np
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().cloud("cloud", np.zeros((7, 3)), np.full((7, 3), 128, dtype=np.uint8))
        """
        self._record(Cloud(entity, points, colors, radius, at))

    def points(
        self,
        entity: str,
        positions: Any,
        *,
        radius: float = 4.0,
        color: Color = TRUTH,
        labels: Sequence[str] = (),
        at: Moment | None = None,
    ) -> None:
        """Markers of single points, as large on the screen at any distance.

        Args:
            entity: name of the markers.
            positions: (N, 3), in the world, m.
            radius: of a marker in points of the screen.
            color: (red, green, blue) or with opacity, 0..255.
            labels: N texts drawn beside the markers, or none.
            at: since when the markers hold; None for the whole recording.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().points("hands/left/true", [[1.2, -0.3, 0.1]], labels=["left"])
        """
        self._record(Markers(entity, positions, radius, color, at, tuple(labels)))

    def ellipsoids(
        self,
        entity: str,
        centers: Any,
        covariance: Any,
        *,
        level: float = 0.95,
        color: Color = PREDICTED,
        labels: Sequence[str] = (),
        at: Moment | None = None,
    ) -> None:
        """Where Gaussian points lie with a given probability, at their true size.

        Args:
            entity: name of the ellipsoids.
            centers: (N, 3), means in the world, m.
            covariance: (N, 3, 3), m^2.
            level: probability that a point is inside its ellipsoid.
            color: (red, green, blue) or with opacity, 0..255.
            labels: N texts, or none.
            at: since when the ellipsoids hold; None for the whole recording.

        Example:
            >>> import numpy as np
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().ellipsoids("hands/left/tracked", [[1.2, -0.3, 0.1]], 1e-6 * np.eye(3)[None])
        """
        self._record(Ellipsoids(entity, centers, covariance, level, color, at, tuple(labels)))

    def mesh(
        self,
        entity: str,
        vertices: Any,
        triangles: Any,
        colors: Any = SCENE,
        *,
        smooth: bool = False,
        at: Moment | None = None,
    ) -> None:
        """A surface of triangles: an object, or cloth that moves.

        Where only the vertices change from moment to moment, only they are stored again.

        Args:
            entity: name of the surface, such as `bag`.
            vertices: (V, 3), in the world, m.
            triangles: (F, 3), indices of vertices.
            colors: (F, 3), uint8, RGB, or one (red, green, blue) for all.
            smooth: whether light changes gradually over edges, as on cloth; else every triangle is flat.
            at: since when the surface is there, until the next one; None for the whole recording.

        Example:
            >>> import numpy as np
            >>> from eaip_prob.recording import NullLogger
            >>> NullLogger().mesh("bag", np.eye(3), [[0, 1, 2]], (200, 205, 215), smooth=True, at=Moment(3, 0.1))
        """
        self._record(Surface(entity, vertices, triangles, colors, smooth, at))

    def image_boxes(
        self,
        entity: str,
        boxes: Any,
        camera: Intrinsics,
        *,
        color: Color = PREDICTED,
        labels: Sequence[str] = (),
        at: Moment | None = None,
    ) -> None:
        """What a detector found in the colour image of a camera.

        The viewer shows straightened images, and the boxes around the same things in them.

        Args:
            entity: name of the camera, as given to `camera`.
            boxes: (N, 4), centre column, centre row, width and height in the image as taken, px; N may be 0.
            camera: the lens of the colour camera.
            color: (red, green, blue) or with opacity, 0..255.
            labels: N texts, or none.
            at: since when the boxes hold; None for the whole recording.

        Example:
            >>> from eaip_prob.recording import NullLogger
            >>> lens = Intrinsics(960, 540, 530.0, 530.0, 480.0, 270.0)
            >>> NullLogger().image_boxes("cameras/right", [[480.0, 300.0, 120.0, 200.0]], lens, labels=["chair 0.93"])
        """
        self._record(ImageBoxes(entity, boxes, camera, color, at, tuple(labels)))
