"""What the robot is told of a trial, frame by frame: by simulated cameras, or by ideal ones with errors of known size.

A perception is chosen by configuration; the loop of a trial sees `Sighting`s and nothing of how they came about.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.detection import AbstractObjectDetector, Detections
from eaip_prob.errors import InputError
from eaip_prob.perception.hands import AbstractHandTracker, HandState
from eaip_prob.simulation import Kinect, KinectModel, KinectNoise, Mesh, Rig, camera_generators
from eaip_prob.simulation.oracle import LabelledFrame, render_labelled
from eaip_prob.tasks.bag_covering.seeing import TRACKING_STD, labelled_frame
from eaip_prob.tasks.bag_covering.site import Site


@dataclass(frozen=True, eq=False)
class Instant:
    """How a trial stands at one time.

    Args:
        time: s.
        hands: (2, 3), the partner's left and right hand, m.
        grippers: (2, 3), the robot's left and right gripper, m.
        bag: its cloth.
    """

    time: float
    hands: Float[np.ndarray, "hands 3"]
    grippers: Float[np.ndarray, "hands 3"]
    bag: Mesh | None = None


@dataclass(frozen=True, eq=False)
class Sighting:
    """What was seen at one time.

    Args:
        time: s.
        hands: as tracked; None before both were seen.
        detections: of objects; None where they were not looked for.
    """

    time: float
    hands: HandState | None
    detections: Detections | None


class AbstractPerception(ABC):
    """Sees one trial at a time; what it knows between instants is passed in and returned.

    Attributes:
        detector: of the object.
        cameras: all units.
        detecting: the unit in whose image it is looked for.
        reads_pixels: whether images are rendered.
    """

    reads_pixels: ClassVar[bool]

    detector: AbstractObjectDetector
    cameras: Sequence[Kinect]
    detecting: Kinect

    @abstractmethod
    def init(self, site: Site, seed: int) -> Any:
        """The state before the first instant.

        Args:
            site: the object in its place.
            seed: of all errors.
        """

    @abstractmethod
    def track(self, instant: Instant, state: Any) -> tuple[HandState | None, Any]:
        """(the partner's hands, next state); None before both were seen.

        Args:
            instant: how things are.
            state: from `init` or the last step.
        """

    @abstractmethod
    def detect(self, instant: Instant, state: Any) -> tuple[Detections, Any]:
        """(the objects, next state).

        Args:
            instant: how things are.
            state: from `init` or the last step.
        """

    def see(self, instant: Instant, state: Any, looks: bool = True) -> tuple[Sighting, Any]:
        """(what is seen, next state).

        Args:
            instant: how things are.
            state: from `init` or the last step.
            looks: whether objects are looked for; else none is found.
        """
        hands, state = self.track(instant, state)
        detections = None
        if looks:
            detections, state = self.detect(instant, state)
        return Sighting(instant.time, hands, detections), state


@dataclass(frozen=True, eq=False)
class _OracleState:
    frame: LabelledFrame
    generator: np.random.Generator


class OraclePerception(AbstractPerception):
    """Hands and object with errors of the size that the simulated cameras have; nothing is rendered or hidden.

    Args:
        rig: where the cameras are.
        camera: their model.
        detector: reads labelled frames, such as `OracleDetector`.
        detecting: name of the camera in whose image the object's box is; the paper's is the right one (Kinect 3).
        tracking_std: of each coordinate of a hand, m.
    """

    reads_pixels = False

    def __init__(
        self,
        rig: Rig,
        camera: KinectModel,
        detector: AbstractObjectDetector,
        detecting: str = "right",
        tracking_std: float = TRACKING_STD,
    ) -> None:
        self.cameras = rig.cameras(camera)
        self.detecting = _named(self.cameras, detecting)
        self.detector, self.tracking_std = detector, tracking_std

    def init(self, site: Site, seed: int) -> _OracleState:
        """As in `AbstractPerception`."""
        return _OracleState(labelled_frame(site, self.detecting), np.random.default_rng([seed, 11]))

    def track(self, instant: Instant, state: _OracleState) -> tuple[HandState, _OracleState]:
        """As in `AbstractPerception`."""
        position = instant.hands + self.tracking_std * state.generator.standard_normal((2, 3))
        covariance = np.tile(self.tracking_std**2 * np.eye(3), (2, 1, 1))
        return HandState(instant.time, position, covariance, np.array([True, True])), state

    def detect(self, instant: Instant, state: _OracleState) -> tuple[Detections, _OracleState]:
        """As in `AbstractPerception`; a detector errs alike while nothing moves, so that all looks are one."""
        return self.detector.detect([state.frame]), state


@dataclass(frozen=True, eq=False)
class _KinectState:
    site: Site
    tracks: Any
    generators: Any


class KinectPerception(AbstractPerception):
    """Three simulated Kinects, the glove tracker and a detector, from pixels.

    Args:
        rig: where the cameras are.
        camera: their model, with as few colours as following gloves takes.
        detector_camera: the model of the one that the detector reads, with as many colours as that takes.
        noise: of their images.
        tracker: of the gloves.
        detector: of the object.
        detecting: name of the camera that the detector reads.
        lost: names of cameras that deliver nothing.

    Raises:
        InputError: `detecting` or one of `lost` that is no camera of the rig.
    """

    reads_pixels = True

    def __init__(
        self,
        rig: Rig,
        camera: KinectModel,
        detector_camera: KinectModel,
        noise: KinectNoise,
        tracker: AbstractHandTracker,
        detector: AbstractObjectDetector,
        detecting: str = "right",
        lost: Sequence[str] = (),
    ) -> None:
        self.cameras, self.noise, self.tracker, self.detector = rig.cameras(camera), noise, tracker, detector
        self.detecting = _named(rig.cameras(detector_camera), detecting)
        self.lost = tuple(_named(self.cameras, name, "lost").name for name in lost)

    def init(self, site: Site, seed: int) -> _KinectState:
        """As in `AbstractPerception`."""
        return _KinectState(site, self.tracker.init(), camera_generators(seed, [unit.name for unit in self.cameras]))

    def track(self, instant: Instant, state: _KinectState) -> tuple[HandState | None, _KinectState]:
        """As in `AbstractPerception`."""
        hands, tracks = self.tracker.step(self.frames(instant, state, self._working), state.tracks, instant.time)
        return hands, replace(state, tracks=tracks)

    def detect(self, instant: Instant, state: _KinectState) -> tuple[Detections, _KinectState]:
        """As in `AbstractPerception`."""
        if self.detecting.name in self.lost:
            return Detections.none(_size(self.detecting)), state
        return self.detector.detect(self.frames(instant, state, [*self._beside, self.detecting])), state

    def see(self, instant: Instant, state: _KinectState, looks: bool = True) -> tuple[Sighting, _KinectState]:
        """As in `AbstractPerception`; each camera delivers one frame, and that of the detector one more."""
        frames = self.frames(instant, state, self._working)
        hands, tracks = self.tracker.step(frames, state.tracks, instant.time)
        detections = None
        if looks and self.detecting.name in self.lost:
            detections = Detections.none(_size(self.detecting))
        elif looks:
            beside = [frame for frame in frames if frame.name != self.detecting.name]
            detections = self.detector.detect([*beside, *self.frames(instant, state, [self.detecting])])
        return Sighting(instant.time, hands, detections), replace(state, tracks=tracks)

    @property
    def _beside(self) -> list[Kinect]:
        """The other cameras, whose depth shows where the object is."""
        return [unit for unit in self._working if unit.name != self.detecting.name]

    @property
    def _working(self) -> list[Kinect]:
        return [unit for unit in self.cameras if unit.name not in self.lost]

    def frames(self, instant: Instant, state: _KinectState, cameras: Sequence[Kinect]) -> list[RGBDFrame]:
        """The frames of some cameras, with noise.

        Args:
            instant: how things are.
            state: from `init` or the last step.
            cameras: that deliver one.
        """
        scene = state.site.room.scene(instant.hands, instant.grippers, bag=instant.bag)
        found = []
        for unit in cameras:
            frame, labels = render_labelled(scene, unit, instant.time, {"thing": state.site.label})
            found.append(self.noise.apply(frame, labels, state.generators[unit.name]))
        return found


def _named(cameras: Sequence[Kinect], name: str, argument: str = "detecting") -> Kinect:
    found = [unit for unit in cameras if unit.name == name]
    if not found:
        raise InputError(f"Expected one of the cameras {[unit.name for unit in cameras]} as {argument}, got {name!r}.")
    return found[0]


def _size(camera: Kinect) -> tuple[int, int]:
    return camera.model.color_camera.width, camera.model.color_camera.height
