"""Rendered clips: the frames of all cameras over a motion, kept on disk so that each is rendered once.

A clip is kept in reels of a second, so that it is never in memory as a whole, and rendering that was interrupted goes
on with the reel that is missing. Depth in whole millimetres, as a Kinect gives it, is kept in two bytes.
"""

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

_FORMAT = "eaip_prob clip 2"
_REEL = 30  # times
_MILLIMETRE = np.float32(0.001)
_FIELDS = ("color", "depth", "valid")


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
        lip: (T, 2, 3), where the partner's edge of the bag is held; default by both hands.

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
    lip: Float[np.ndarray, "time sides 3"] = None  # pyright: ignore[reportAssignmentType]

    def __post_init__(self) -> None:
        if self.lip is None:
            object.__setattr__(self, "lip", self.hands)
        for name in ("hands", "grippers", "lip"):
            expected = (len(self.time), 2, 3)
            if np.shape(getattr(self, name)) != expected:
                raise ShapeError(
                    f"Expected {name} with shape {expected}, got {np.shape(getattr(self, name))}. "
                    "Give one row for each time."
                )

    def __len__(self) -> int:
        return len(self.time)

    def key(self) -> str:
        """What the frames follow from, as 32 hexadecimal digits; a mesh file counts by what is in it."""
        digest = hashlib.sha256()
        thing = self.workspace.thing.mesh()
        words = (_FORMAT, self.workspace, self.noise, self.seed, [(c.name, c.model) for c in self.cameras])
        digest.update(repr(words).encode())
        poses = [camera.T_world_camera for camera in self.cameras]
        motions = (self.time, self.hands, self.grippers, self.lip)
        for array in (*motions, *poses, thing.vertices, thing.triangles, thing.color):
            digest.update(repr(np.shape(array)).encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:32]

    def frames(self, folder: Path) -> Iterator[list[RGBDFrame]]:
        """The frames of all cameras, time by time: from the folder, or rendered and written there.

        Args:
            folder: where clips are kept; one folder each, named by `key`, with a file for every reel.

        Raises:
            DataFileError: a file in the folder is damaged.
        """
        home = Path(folder) / f"clip-{self.key()}"
        for first in range(0, len(self), _REEL):
            path = home / f"reel-{first:05d}.npz"
            if path.is_file():
                yield from self._restored(read_arrays(path), first)
                continue
            steps = list(self.render(first))
            write_arrays(path, self._kept(steps), compressed=True)
            yield from steps

    def render(self, first: int = 0) -> Iterator[list[RGBDFrame]]:
        """The frames of all cameras in one reel, time by time.

        Args:
            first: index of the reel's first time.
        """
        generators = camera_generators((self.seed, first), [camera.name for camera in self.cameras])
        for at in range(first, min(first + _REEL, len(self))):
            scene = self.workspace.scene(self.hands[at], self.grippers[at], self.lip[at])
            pairs = [(camera, *render_rgbd(scene, camera, float(self.time[at]))) for camera in self.cameras]
            yield [self.noise.apply(frame, labels, generators[camera.name]) for camera, frame, labels in pairs]

    def _kept(self, steps: Sequence[Sequence[RGBDFrame]]) -> dict[str, np.ndarray]:
        return {
            f"{name}_{place}": _small(np.stack([getattr(step[place], name) for step in steps]))
            for place in range(len(self.cameras))
            for name in _FIELDS
        }

    def _restored(self, arrays: dict[str, np.ndarray], first: int) -> Iterator[list[RGBDFrame]]:
        for at in range(first, min(first + _REEL, len(self))):
            yield [self._frame(camera, place, at, at - first, arrays) for place, camera in enumerate(self.cameras)]

    def _frame(self, camera: Kinect, place: int, at: int, row: int, arrays: dict[str, np.ndarray]) -> RGBDFrame:
        color, depth, valid = (arrays[f"{name}_{place}"][row] for name in _FIELDS)
        return RGBDFrame(
            color=color,
            depth=_metres(depth),
            valid=valid,
            intrinsics=camera.model.depth,
            T_world_camera=camera.T_world_camera,
            time=float(self.time[at]),
            color_intrinsics=camera.model.color_camera,
            T_color_depth=camera.model.T_color_depth,
            name=camera.name,
        )


def _small(shot: np.ndarray) -> np.ndarray:
    """Depth in whole millimetres where nothing is lost by it; all else as it is."""
    if shot.dtype != np.float32:
        return shot
    whole = np.rint(np.clip(shot, 0.0, 65.0) / _MILLIMETRE).astype(np.uint16)
    return whole if np.array_equal(_metres(whole), shot) else shot


def _metres(depth: np.ndarray) -> np.ndarray:
    return depth if depth.dtype == np.float32 else depth.astype(np.float32) * _MILLIMETRE
