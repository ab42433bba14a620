"""What Kinect 3 sees of an object while a robot and a person cover it with a bag: the views behind Table 1.

In `CoveringViews` the bag is a sheet between four hands. In the first half of the task it is lifted above the object,
beside the line of sight; in the second half it comes down to the object's top, and its skirt slides over the sides.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from eaip_prob.data.archive import read_arrays, write_arrays
from eaip_prob.errors import DataFileError, InputError
from eaip_prob.simulation import Bag, Kinect, KinectNoise, Scene, Workspace, camera_generators
from eaip_prob.simulation.oracle import LabelledFrame, TrueObject, render_labelled

_FORMAT = "eaip_prob covering 1"
_HALF = 0.5
_SIDES = np.array([0.36, -0.36])  # y of both edges of the bag beside the object's middle, m
_NEAR, _FAR = -0.35, 0.42  # x of the robot's and the person's edge beside the object's middle, m
_START, _LIFTED, _ABOVE = 0.45, 0.65, 0.06  # height of the edges above the object's top, m
_SKIRT, _DRAPED = 0.12, 0.75  # length of the skirt: at first (m), and at the end (share of the object's height)


@dataclass(frozen=True)
class Placement:
    """Where the object stands in one trial, and who covers it.

    Args:
        position: (x, y) of the object, m.
        turn: of the object about the vertical axis, rad.
        stature: of the person, m.

    Example:
        >>> Placement.drawn(np.random.default_rng(0)).stature > 1.5
        True
    """

    position: tuple[float, float]
    turn: float
    stature: float

    @classmethod
    def drawn(cls, generator: np.random.Generator, spread: float = 0.1, turn: float = -0.9, turned: float = 0.7):
        """A placement in the workspace.

        Args:
            generator: of the draw.
            spread: largest shift along x and y from the middle, m.
            turn: of the object in the middle of its range, rad.
            turned: largest turn from that, rad.
        """
        x, y = np.array([0.95, 0.0]) + generator.uniform(-spread, spread, 2)
        return cls((float(x), float(y)), turn + generator.uniform(-turned, turned), generator.uniform(1.6, 1.85))


@dataclass(frozen=True, eq=False)
class AbstractCoveringViews(ABC):
    """The frames of one camera over one trial; a subclass gives `key` and `render`.

    Args:
        label: class of the object.
        camera: the unit, with the colour camera at the detector's resolution.
        count: of frames, evenly over the task.
        noise: of the unit.
        seed: of the noise.

    Raises:
        InputError: fewer than two frames.
    """

    label: str
    camera: Kinect
    count: int
    noise: KinectNoise
    seed: int

    def __post_init__(self) -> None:
        if self.count < 2:
            raise InputError(f"Expected at least two frames of a trial, got {self.count}.")

    @property
    def share(self) -> Float[np.ndarray, "frames"]:
        """How much of the task has passed at each frame, 0 to 1."""
        return (np.arange(self.count) + 0.5) / self.count

    @abstractmethod
    def key(self) -> str:
        """What the frames follow from, as 32 hexadecimal digits."""

    @abstractmethod
    def render(self) -> Iterator[LabelledFrame]:
        """The frames in the order of time, with noise."""

    def frames(self, folder: Path) -> list[LabelledFrame]:
        """All frames, from the folder, or rendered and written there.

        Args:
            folder: where views are kept; a file each, named by `key`.

        Raises:
            DataFileError: the file in the folder is damaged.
        """
        path = Path(folder) / f"covering-{self.key()}.npz"
        if path.is_file():
            return self._restored(read_arrays(path))
        frames = list(self.render())
        truth = np.array([[*one.box, one.covered, *one.place] for frame in frames for one in frame.objects])
        arrays = {f"color_{i}": cv2.imencode(".png", frame.color)[1] for i, frame in enumerate(frames)}
        arrays |= {f"depth_{i}": cv2.imencode(".png", _millimetres(frame))[1] for i, frame in enumerate(frames)}
        write_arrays(path, {**arrays, "truth": truth})
        return frames

    def digest(self, words: tuple, *arrays: np.ndarray) -> str:
        """Of what all views follow from, and of what else these do.

        Args:
            words: with a representation that tells them apart.
            arrays: of any shape.
        """
        words = (_FORMAT, *words, self.label, self.noise, self.seed, self.count, self.camera.name, self.camera.model)
        found = hashlib.sha256(repr(words).encode())
        for array in (self.camera.T_world_camera, *arrays):
            found.update(repr(np.shape(array)).encode() + np.ascontiguousarray(array).tobytes())
        return found.hexdigest()[:32]

    def shown(self, scene: Scene, share: float, generator: np.random.Generator) -> LabelledFrame:
        """One frame, with noise.

        Args:
            scene: what is there.
            share: of the task that has passed.
            generator: of the noise.
        """
        frame, labels = render_labelled(scene, self.camera, share, {"thing": self.label})
        noisy = self.noise.apply(frame, labels, generator)
        assert isinstance(noisy, LabelledFrame)
        return noisy

    def generator(self) -> np.random.Generator:
        """Of the noise of the whole trial."""
        return camera_generators(self.seed, [self.camera.name])[self.camera.name]

    def _restored(self, arrays: dict[str, np.ndarray]) -> list[LabelledFrame]:
        model, frames = self.camera.model, []
        for i, share in enumerate(self.share):
            depth = _picture(arrays[f"depth_{i}"]).astype(np.float32) * np.float32(0.001)
            row = arrays["truth"][i]
            frames.append(
                LabelledFrame(
                    color=_picture(arrays[f"color_{i}"]),
                    depth=depth,
                    valid=depth > 0,
                    intrinsics=model.depth,
                    T_world_camera=self.camera.T_world_camera,
                    time=float(share),
                    color_intrinsics=model.color_camera,
                    T_color_depth=model.T_color_depth,
                    name=self.camera.name,
                    objects=(TrueObject(self.label, row[:4], float(row[4]), row[5:]),),
                )
            )
        return frames


@dataclass(frozen=True, eq=False)
class CoveringViews(AbstractCoveringViews):
    """A trial with a sheet that is carried up, over and down.

    Args:
        workspace: with the object in it; where it stands is the placement's.
        placement: of the object and the person.

    Raises:
        InputError: fewer than two frames.
    """

    workspace: Workspace
    placement: Placement

    def key(self) -> str:
        """As in `AbstractCoveringViews`."""
        thing = self.workspace.thing.mesh()
        return self.digest((self.workspace, self.placement), thing.vertices, thing.triangles, thing.color)

    def render(self) -> Iterator[LabelledFrame]:
        """As in `AbstractCoveringViews`."""
        generator = self.generator()
        for share in self.share:
            yield self.shown(self.scene(float(share)), float(share), generator)

    def scene(self, share: float) -> Scene:
        """What is there when a share of the task has passed.

        Args:
            share: 0 to 1.
        """
        thing = self.workspace.thing.mesh().extent()
        height = float(thing[1, 2] - thing[0, 2])
        lip, grippers, skirt = self._bag(share, height)
        bag = Bag(sag=0.02, skirt=skirt, color=(Bag() if self.workspace.bag is None else self.workspace.bag).color)
        room = replace(
            self.workspace,
            person=replace(self.workspace.person, stature=self.placement.stature),
            bag=bag,
            thing_position=self.placement.position,
            thing_turn=self.placement.turn,
        )
        return room.scene(lip, grippers)

    def _bag(self, share: float, height: float) -> tuple[np.ndarray, np.ndarray, float]:
        """(lip at the person's hands, left one first; lip at the grippers; length of the skirt)."""
        top = self.workspace.floor + height
        lifting, coming = min(share / _HALF, 1.0), max(share - _HALF, 0.0) / (1.0 - _HALF)
        above = _START + (_LIFTED - _START) * lifting + (_ABOVE - _LIFTED) * coming
        x, y = self.placement.position
        hands = np.array([[x + _FAR, y + side, top + above] for side in _SIDES[::-1]])
        grippers = np.array([[x + _NEAR, y + side, top + above] for side in _SIDES])
        return hands, grippers, _SKIRT + (_DRAPED * height - _SKIRT) * coming


def _picture(kept: np.ndarray) -> np.ndarray:
    picture = cv2.imdecode(kept, cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise DataFileError("Expected pictures in a file of views, got damaged ones. Delete it; it is rendered again.")
    return picture


def _millimetres(frame: LabelledFrame) -> np.ndarray:
    return np.rint(np.where(frame.valid, frame.depth, 0.0) / np.float32(0.001)).astype(np.uint16)
