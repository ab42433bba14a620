"""What is where: detectors of objects, and the features of the environment that are drawn from what they answer."""

from eaip_prob.detection.base import (
    CLASSES,
    AbstractImageDetector,
    AbstractObjectDetector,
    Detections,
    check_image,
    frame_of,
)
from eaip_prob.detection.encoder import AbstractEnvironmentEncoder, AbstractObjectEncoder, ObjectChoice
from eaip_prob.detection.encoders import (
    BoxEncoder,
    ExactEncoder,
    MetricBoxEncoder,
    NoEncoder,
    OneHotEncoder,
    PaperEncoder,
)
from eaip_prob.detection.encoders_noise import FeatureErrors, feature_errors
from eaip_prob.detection.network_input import NetworkInput
from eaip_prob.detection.onnx import OnnxDetector
from eaip_prob.detection.onnx_layouts import AbstractOutputLayout, YoloV2Layout, YoloV8Layout, YoloXLayout
from eaip_prob.detection.placing import placed
from eaip_prob.detection.point_cloud import PointCloudDetector

__all__ = [
    "CLASSES",
    "AbstractEnvironmentEncoder",
    "AbstractImageDetector",
    "AbstractObjectDetector",
    "AbstractObjectEncoder",
    "AbstractOutputLayout",
    "BoxEncoder",
    "Detections",
    "ExactEncoder",
    "FeatureErrors",
    "MetricBoxEncoder",
    "NetworkInput",
    "NoEncoder",
    "ObjectChoice",
    "OneHotEncoder",
    "OnnxDetector",
    "PaperEncoder",
    "PointCloudDetector",
    "YoloV2Layout",
    "YoloV8Layout",
    "YoloXLayout",
    "check_image",
    "feature_errors",
    "frame_of",
    "placed",
]
