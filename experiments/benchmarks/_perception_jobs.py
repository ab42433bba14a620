"""What `perception.py` times: moments of a scripted motion before three Kinects, and the operations on them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eaip_prob.data import RGBDFrame
    from eaip_prob.perception import GloveTracker, HandState
    from eaip_prob.simulation import Clip, Kinect, Labels


@dataclass(frozen=True, eq=False)
class Moments:
    """Some moments of a motion, with all that the operations need.

    Args:
        clip: what is filmed.
        detector: the unit whose colour image a detector reads.
        frames: of all cameras, noisy, time by time.
        clean: before the noise, with what each pixel truly shows.
        states: of the tracker before each moment.
        tracker: of the gloves.
        crop: of the workspace, m.
        voxel: m.
    """

    clip: Clip
    detector: Kinect
    frames: Sequence[Sequence[RGBDFrame]]
    clean: Sequence[Sequence[tuple[RGBDFrame, Labels]]]
    states: Sequence[Any]
    tracker: GloveTracker
    crop: Any
    voxel: float

    @classmethod
    def of(cls, cfg: DictConfig) -> Moments:
        """The moments that a configuration asks for, from the middle of the motion `free`."""
        from eaip_prob.config import build
        from eaip_prob.simulation import render_rgbd
        from eaip_prob.simulation.kinect_noise import camera_generators
        from eaip_prob.tasks.kinects import Scenario

        rig, noise, tracker = build(cfg.rig), build(cfg.kinect_noise), build(cfg.tracker)
        clip = Scenario("free").clip(30.0, build(cfg.workspace), rig.cameras(build(cfg.camera)), noise, cfg.seed)
        detector = rig.cameras(build(cfg.detector_camera))[-1]
        generators = camera_generators(cfg.seed, [camera.name for camera in clip.cameras])
        frames, clean, states, state = [], [], [], tracker.init()
        for at in range(30, 30 + cfg.moments):
            scene, seconds = clip.workspace.scene(clip.hands[at], clip.grippers[at]), float(clip.time[at])
            clean.append([render_rgbd(scene, camera, seconds) for camera in clip.cameras])
            frames.append([noise.apply(*pair, generators[pair[0].name]) for pair in clean[-1]])
            states.append(state)
            state = tracker.step(frames[-1], state)[1]
        crop = tuple((low, high) for low, high in cfg.crop)
        return cls(clip, detector, frames, clean, states, tracker, crop, cfg.voxel)

    def tracked(self, count: int) -> Iterator[tuple[HandState | None, int]]:
        """(hands, points of the fused cloud) of many frames: the moments again and again, as time goes on."""
        from eaip_prob.perception import fuse

        state = self.tracker.init()
        for number in range(count):
            moment = self.frames[number % len(self.frames)]
            now = [replace(frame, time=number / 30.0) for frame in moment]
            hands, state = self.tracker.step(now, state)
            yield hands, len(fuse(now, self.crop, self.voxel))


def jobs(moments: Moments, seed: int, folder: Path) -> dict[str, Callable[[], Any]]:
    """All operations under their names; those of `plain/` are another way to the same.

    The exported network is written to the folder.
    """
    import numpy as np

    from eaip_prob.detection import OnnxDetector
    from eaip_prob.detection.yolo import YoloDetector, export_onnx
    from eaip_prob.detection.yolo.detector import SHIPPED
    from eaip_prob.perception import fuse
    from eaip_prob.simulation import render_color, render_rgbd

    clip, places = moments.clip, itertools.count()
    yolo, onnx = YoloDetector(), OnnxDetector(export_onnx(SHIPPED, folder / "furniture.onnx"))
    image = render_color(clip.workspace.scene(clip.hands[30], clip.grippers[30]), moments.detector.color_view)
    generator = np.random.default_rng(seed)

    def turn() -> int:
        return next(places) % len(moments.frames)

    def scene() -> Any:
        at = 30 + turn()
        return clip.workspace.scene(clip.hands[at], clip.grippers[at])

    def render() -> Any:
        now = scene()
        return [render_rgbd(now, camera, 0.0) for camera in clip.cameras]

    def track() -> Any:
        at = 1 + turn() % (len(moments.frames) - 1)
        return moments.tracker.step(moments.frames[at], moments.states[at])

    return {
        "ms/render_rgbd_3": render,
        "ms/render_colour_960": lambda: render_color(scene(), moments.detector.color_view),
        "ms/noise": lambda: clip.noise.apply(*moments.clean[turn()][0], generator),
        "ms/track_3": track,
        "ms/yolo": lambda: yolo.detect_image(image),
        "ms/onnx": lambda: onnx.detect_image(image),
        "ms/fuse_3": lambda: fuse(moments.frames[turn()], moments.crop, moments.voxel),
        "plain/fuse_3": lambda: open3d_fused(moments.frames[turn()], moments.crop, moments.voxel),
    }


def open3d_fused(frames: Sequence[RGBDFrame], crop: Any, voxel: float) -> Any:
    """The same cloud by open3d's own filters; lenses are inverted by us, since open3d takes pinhole cameras only."""
    import numpy as np
    import open3d

    from eaip_prob.perception import registered

    whole = open3d.geometry.PointCloud()
    for frame in frames:
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(frame.points()))
        cloud.colors = open3d.utility.Vector3dVector(registered(frame).color[frame.valid] / 255.0)
        whole += cloud
    low, high = np.array(crop).T
    return whole.crop(open3d.geometry.AxisAlignedBoundingBox(low, high)).voxel_down_sample(voxel)
