"""YOLO v2 (Redmon and Farhadi, 2017) in torch: the network, its training, and a detector that runs trained weights."""

from eaip_prob.detection.yolo.augmentation import Augmentation
from eaip_prob.detection.yolo.detector import YoloDetector
from eaip_prob.detection.yolo.export import export_onnx
from eaip_prob.detection.yolo.loss import LossScales
from eaip_prob.detection.yolo.network import YoloNetwork, YoloShape
from eaip_prob.detection.yolo.training import Trainer, Training
from eaip_prob.detection.yolo.weights_file import YoloSettings, read_weights, write_weights

__all__ = [
    "Augmentation",
    "LossScales",
    "Trainer",
    "Training",
    "YoloDetector",
    "YoloNetwork",
    "YoloSettings",
    "YoloShape",
    "export_onnx",
    "read_weights",
    "write_weights",
]
