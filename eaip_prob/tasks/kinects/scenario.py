"""A scripted motion with what else makes tracking hard: cameras that fail, another glove, a turned shelf."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.errors import InputError
from eaip_prob.simulation import Clip, Kinect, KinectNoise, Workspace
from eaip_prob.tasks.kinects.paths import HandPath, hand_path


@dataclass(frozen=True)
class Scenario:
    """What is played before the cameras.

    Args:
        motion: of the hands, by its name.
        glove_radius: m; the tracker is told of it.
        thing_turn: of the object about the vertical axis, rad; as the workspace says if None.
        lost: camera -> (from, until), s, while it delivers no frame.

    Raises:
        InputError: a radius not above zero, or a time that ends before it begins.

    Example:
        >>> Scenario("free", lost={"right": (0.8, 9.0)}).path(rate=10.0).time[-1]
        np.float64(3.2)
    """

    motion: str
    glove_radius: float = 0.048
    thing_turn: float | None = None
    lost: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.glove_radius > 0:
            raise InputError(f"Expected glove_radius above zero, got {self.glove_radius}. Give metres.")
        for camera, span in self.lost.items():
            if len(span) != 2 or not span[0] < span[1]:
                raise InputError(f"Expected lost of the camera {camera!r} as [from, until] in seconds, got {span}.")

    def path(self, rate: float) -> HandPath:
        """The hands, frame by frame.

        Args:
            rate: frames a second.
        """
        return hand_path(self.motion, rate)

    def clip(self, rate: float, room: Workspace, cameras: Sequence[Kinect], noise: KinectNoise, seed: int) -> Clip:
        """What is rendered.

        Args:
            rate: frames a second.
            room: with the object in it.
            cameras: the units.
            noise: of every unit.
            seed: of the noise.
        """
        path = self.path(rate)
        person = replace(room.person, glove_radii=(self.glove_radius,) * 3)
        turn = room.thing_turn if self.thing_turn is None else self.thing_turn
        room = replace(room, person=person, thing_turn=turn)
        return Clip(room, cameras, path.time, path.position, path.grippers, noise, seed, path.lips)

    def delivered(self, frames: Iterable[Sequence[RGBDFrame]]) -> Iterator[list[RGBDFrame]]:
        """Frames, time by time, without those of cameras that are lost.

        Args:
            frames: of all cameras.
        """
        for step in frames:
            yield [frame for frame in step if not self._is_lost(frame)]

    def _is_lost(self, frame: RGBDFrame) -> bool:
        begin, end = self.lost.get(frame.name, (0.0, 0.0))
        return begin <= frame.time < end
