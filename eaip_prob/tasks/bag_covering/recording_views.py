"""What the cameras of a run see, for the rerun viewer: images, the boxes detected in them, and fused clouds."""

from __future__ import annotations

from collections.abc import Sequence

from eaip_prob.data.frames import RGBDFrame
from eaip_prob.detection import Detections
from eaip_prob.perception.fusion import fuse, inliers
from eaip_prob.recording import AbstractRunLogger, Moment
from eaip_prob.tasks.bag_covering.replaying import Cameras, RobotBodies
from eaip_prob.tasks.bag_covering.running import Job
from eaip_prob.tasks.bag_covering.trial import Step

WORKSPACE = ((-0.3, 2.3), (-1.2, 1.2), (-0.9, 1.2))  # m; robot, object and person, just above the floor
_VIEWS, _CLOUDS = 15, 30  # steps, 30 a second, from one to the next; more in long runs
_USUAL = 300  # steps; a recording of that many takes about 20 MB
_VOXEL = 0.02  # m


def moment_of(number: int, step: Step) -> Moment:
    """Where a step stands on both timelines: at its time, and after so many steps.

    Args:
        number: of the step, from 0.
        step: of a trial.
    """
    return Moment(number + 1, step.instant.time)


def lengthened(steps: Sequence[Step]) -> int:
    """How many times as long as usual a run was, rounded up.

    Args:
        steps: all of a trial.

    Example:
        >>> lengthened([None] * 300), lengthened([None] * 301)
        (1, 2)
    """
    return -(-len(steps) // _USUAL)


def labels_of(found: Detections) -> list[str]:
    """Class and score of each detection.

    Args:
        found: by a detector.

    Example:
        >>> import numpy as np
        >>> labels_of(Detections(("chair",), np.array([0.934]), np.array([[9.0, 9.0, 4.0, 6.0]]), (20, 20)))
        ['chair 0.93']
    """
    return [f"{label} {score:.2f}" for label, score in zip(found.labels, found.score, strict=True)]


def record_views(logger: AbstractRunLogger, job: Job, steps: Sequence[Step], bodies: RobotBodies | None) -> None:
    """Images of all cameras with the detected boxes twice a second, and the fused cloud once.

    Args:
        logger: of this recording.
        job: that was run.
        steps: all of its steps.
        bodies: of the robot at each; None where there is none.
    """
    perception, case = job.setting.perception, job.case
    cameras = Cameras(perception, case.site, case.seed)
    longer = lengthened(steps)
    for number in range(0, len(steps), longer * _VIEWS):
        step, at = steps[number], moment_of(number, steps[number])
        frames = list(cameras.frames(step.instant, None if bodies is None else bodies.whole(number)))
        for frame in frames:
            logger.camera(f"cameras/{frame.name}", frame, at=at)
        if number % (longer * _CLOUDS) == 0:
            cloud = fuse(frames, WORKSPACE, _VOXEL)
            cloud = cloud.select(inliers(cloud))
            logger.cloud("cloud", cloud.points, cloud.colors, radius=_VOXEL / 2, at=at)
        detected_in = [frame for frame in frames if frame.name == perception.detecting.name]
        found = None if step.sighting is None else step.sighting.detections
        if found is not None and detected_in:
            _record_image_boxes(logger, detected_in[0], found, at)


def _record_image_boxes(logger: AbstractRunLogger, frame: RGBDFrame, found: Detections, at: Moment) -> None:
    camera = frame.color_intrinsics or frame.intrinsics
    scale = camera.width / found.image_size[0]
    boxes = scale * found.box
    boxes[:, :2] += 0.5 * (scale - 1.0)  # pixels are counted from the centre of the first
    logger.image_boxes(f"cameras/{frame.name}", boxes, camera, labels=labels_of(found), at=at)
