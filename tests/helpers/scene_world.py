from __future__ import annotations

from typing import Any

from omegaconf import OmegaConf

from eaip_prob.config import build, conf_dir
from eaip_prob.data.frames import Intrinsics
from eaip_prob.simulation import Kinect, KinectModel, Part, Scene, box, looking_at

SMALL = Intrinsics(64, 53, 45.68, 45.68, 31.8, 25.6, (0.0905, -0.2683, 0.001, -0.002, 0.0951))
COLOR = Intrinsics(80, 45, 44.0, 44.1, 39.8, 21.5, (0.054, -0.068, 0.0, 0.0, 0.0))


def from_conf(name: str, **arguments: Any) -> Any:
    return build(OmegaConf.load(conf_dir() / f"{name}.yaml"), **arguments)


def small_camera(position=(-1.0, 0.3, 1.0), target=(1.0, 0.0, 0.0), name="left") -> Kinect:
    model = KinectModel(SMALL, COLOR, (-0.05, -0.01, 0.002), (0.0, 1.0, 0.5))
    return Kinect(name, model, looking_at(position, target))


def two_boxes() -> Scene:
    floor = Part("floor", box((9.0, 9.0, 0.2), (0.6, 0.6, 0.6)).at(z=-0.6), tile=0.5)
    return Scene([floor, Part("red", box((0.4, 0.5, 0.6), (0.9, 0.1, 0.1)).at(1.0, 0.1, 0.0))])
