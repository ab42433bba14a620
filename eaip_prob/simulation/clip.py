"""Rendered clips: the frames of all cameras over a motion, kept on disk so that each is rendered once."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from eaip_prob.data.archive import read_arrays, write_arrays
from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import ShapeError
from eaip_prob.simulation.kinect import Kinect, render_rgbd
from eaip_prob.simulation.kinect_noise import KinectNoise, camera_generators
from eaip_prob.simulation.workspace import Workspace

_FORMAT = "eaip_prob clip 1"


@dataclass(frozen=True, eq=False)
class Clip:
    """What is filmed: a motion in a workspace.

    Args:
        workspace: the room.
        cameras: the units, which all take a frame at each time.
        time: (T,), s.
        hands: (T, 2, 3), centres of the left and the right glove, m.
        grippers: (T, 2, 3), tips of the robot's left and right gripper, m.
        noise: of every unit.
        seed: of the noise.

    Raises:
        ShapeError: motions of another shape than the times say.

    Example:
        >>> Clip(Workspace(None), (), np.zeros(2), np.zeros((3, 2, 3)), np.zeros((2, 2, 3)))
        Traceback (most recent call last):
        eaip_prob.errors.ShapeError: Expected hands with shape (2, 2, 3), got (3, 2, 3). Give one row for each time.
    """

    workspace: Workspace
    cameras: Sequence[Kinect]
    time: Float[np.ndarray, "time"]
    hands: Float[np.ndarray, "time hands 3"]
    grippers: Float[np.ndarray, "time hands 3"]
    noise: KinectNoise = KinectNoise()
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("hands", "grippers"):
            expected = (len(self.time), 2, 3)
            if np.shape(getattr(self, name)) != expected:
                raise ShapeError(
                    f"Expected {name} with shape {expected}, got {np.shape(getattr(self, name))}. "
                    "Give one row for each time."
                )

    def key(self) -> str:
        """What the frames follow from, as 32 hexadecimal digits; a mesh file counts by what is in it."""
        digest = hashlib.sha256()
        thing = self.workspace.thing.mesh()
        words = (_FORMAT, self.workspace, self.noise, self.seed, [(c.name, c.model) for c in self.cameras])
        digest.update(repr(words).encode())
        poses = [camera.T_world_camera for camera in self.cameras]
        for array in (self.time, self.hands, self.grippers, *poses, thing.vertices, thing.triangles, thing.color):
            digest.update(repr(np.shape(array)).encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:32]

    def render(self) -> Iterator[list[RGBDFrame]]:
        """The frames of all cameras, time by time."""
        generators = camera_generators(self.seed, [camera.name for camera in self.cameras])
        for time, hands, grippers in zip(self.time, self.hands, self.grippers, strict=True):
            scene = self.workspace.scene(hands, grippers)
            pairs = [(camera, *render_rgbd(scene, camera, float(time))) for camera in self.cameras]
            yield [self.noise.apply(frame, labels, generators[camera.name]) for camera, frame, labels in pairs]

    def frames(self, folder: Path) -> list[list[RGBDFrame]]:
        """The frames of all cameras, time by time: from the folder, or rendered and written there.

        Args:
            folder: where clips are kept; one file each, named by `key`.

        Raises:
            DataFileError: the file in the folder is damaged.
        """
        path = Path(folder) / f"clip-{self.key()}.npz"
        if path.is_file():
            return self._restored(read_arrays(path))
        frames = list(self.render())
        arrays = {
            f"{name}_{place}": np.stack([getattr(step[place], name) for step in frames])
            for place in range(len(self.cameras))
            for name in ("color", "depth", "valid")
        }
        write_arrays(path, arrays)
        return frames

    def _restored(self, arrays: dict[str, np.ndarray]) -> list[list[RGBDFrame]]:
        return [
            [self._frame(camera, place, step, arrays) for place, camera in enumerate(self.cameras)]
            for step in range(len(self.time))
        ]

    def _frame(self, camera: Kinect, place: int, step: int, arrays: dict[str, np.ndarray]) -> RGBDFrame:
        color, depth, valid = (arrays[f"{name}_{place}"][step] for name in ("color", "depth", "valid"))
        return RGBDFrame(
            color=color,
            depth=depth,
            valid=valid,
            intrinsics=camera.model.depth,
            T_world_camera=camera.T_world_camera,
            time=float(self.time[step]),
            color_intrinsics=camera.model.color_camera,
            T_color_depth=camera.model.T_color_depth,
            name=camera.name,
        )
