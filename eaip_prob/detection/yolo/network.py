"""The network of YOLO v2 (Redmon and Farhadi 2017; Fig. 8 of the paper), with fewer channels where that is enough.

31 layers as Darknet counts them, poolings, routes and the reorganisation included: the body of Darknet-19 without its
classifier, two further convolutions, a pass-through of the finer map whose blocks of 2 x 2 cells are stacked along the
channels, one convolution over both, and one to the answers. Letters: B images, A anchors, C classes, cells of 32 px.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils import fuse_conv_bn_eval

from eaip_prob.errors import InputError

CELL = 32  # px of the input along a cell of the answer
_SLOPE = 0.1  # of the leaky rectifier
# Channels at full width and kernel size; M halves the image.
_FINE: tuple[str | tuple[int, int], ...] = (
    (32, 3),
    "M",
    (64, 3),
    "M",
    (128, 3),
    (64, 1),
    (128, 3),
    "M",
    (256, 3),
    (128, 1),
    (256, 3),
    "M",
)
_FINE += ((512, 3), (256, 1), (512, 3), (256, 1), (512, 3))
_COARSE = ("M", (1024, 3), (512, 1), (1024, 3), (512, 1), (1024, 3), (1024, 3), (1024, 3))
_PASSED, _JOINED = (64, 1), (1024, 3)


@dataclass(frozen=True)
class YoloShape:
    """What a network's weights must fit.

    Args:
        width: factor on all channels of YOLO v2.
        num_anchors: A.
        num_classes: C.

    Raises:
        InputError: a width that leaves no channel, or no anchors or classes.

    Example:
        >>> YoloShape(0.25, num_anchors=5, num_classes=4).channels(1024)
        256
    """

    width: float = 0.25
    num_anchors: int = 5
    num_classes: int = 4

    def __post_init__(self) -> None:
        if not 1 / 32 <= self.width <= 4 or self.num_anchors < 1 or self.num_classes < 1:
            raise InputError(f"Expected a width from 1/32 to 4, and at least one anchor and class, got {self}.")

    def channels(self, full: int) -> int:
        """Channels of a layer that has `full` in YOLO v2.

        Args:
            full: channels at width 1.
        """
        return max(int(full * self.width), 1)


class YoloNetwork(nn.Module):
    """Answers for every cell and anchor, of images whose sides are multiples of 32 px.

    Args:
        shape: of the network.
        generator: of the weights, drawn after He et al. (2015); left at zero without one, to be loaded.

    Example:
        >>> network = YoloNetwork(YoloShape(1 / 16), torch.Generator().manual_seed(0)).eval()
        >>> network(torch.zeros(2, 3, 160, 288)).shape, network.num_layers
        (torch.Size([2, 45, 5, 9]), 31)
    """

    def __init__(self, shape: YoloShape, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.shape = shape
        self.fine, fine = _stack(shape, 3, _FINE)
        self.coarse, coarse = _stack(shape, fine, _COARSE)
        self.passed, passed = _stack(shape, fine, (_PASSED,))
        self.joined, joined = _stack(shape, coarse + 4 * passed, (_JOINED,))
        self.answer = _convolution(joined, shape.num_anchors * (5 + shape.num_classes), 1, bias=True)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.zeros_(module.weight)
                if generator is not None:
                    nn.init.kaiming_normal_(module.weight, a=_SLOPE, nonlinearity="leaky_relu", generator=generator)
        if generator is not None:
            self.answer.weight.data.mul_(0.1)  # boxes begin as the anchors

    def forward(self, image: Float[Tensor, "batch 3 height width"]) -> Float[Tensor, "batch answers rows columns"]:
        """Raw answers (B, A (5 + C), rows, columns), of each anchor x, y, width, height, objectness, classes.

        Args:
            image: (B, 3, H, W), RGB from 0 to 1.
        """
        fine = self.fine(image)
        passed = nn.functional.pixel_unshuffle(self.passed(fine), 2)
        return self.answer(self.joined(torch.cat([passed, self.coarse(fine)], 1)))

    @property
    def num_layers(self) -> int:
        """Convolutions, poolings, two routes and the reorganisation."""
        return sum(isinstance(module, nn.Conv2d | nn.MaxPool2d) for module in self.modules()) + 3


def _convolution(inside: int, outside: int, size: int, bias: bool) -> nn.Conv2d:
    # Left as it is in memory: torch's own start would draw from the global generator.
    made: Any = nn.utils.skip_init(nn.Conv2d, inside, outside, size, padding=size // 2, bias=bias)
    if bias:
        nn.init.zeros_(made.bias)
    return made


def _stack(shape: YoloShape, inside: int, plan: Sequence[str | tuple[int, int]]) -> tuple[nn.Sequential, int]:
    layers: list[nn.Module] = []
    for entry in plan:
        if isinstance(entry, str):
            layers.append(nn.MaxPool2d(2))
            continue
        outside = shape.channels(entry[0])
        layers += [_convolution(inside, outside, entry[1], bias=False), nn.BatchNorm2d(outside)]
        layers.append(nn.LeakyReLU(_SLOPE, inplace=True))
        inside = outside
    return nn.Sequential(*layers), inside


def folded(network: YoloNetwork) -> YoloNetwork:
    """A copy for inference, with each batch normalisation taken into the convolution before it.

    Args:
        network: left as it is.

    Example:
        >>> network = YoloNetwork(YoloShape(1 / 32), torch.Generator().manual_seed(0)).eval()
        >>> image = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(1))
        >>> bool((network(image) - folded(network)(image)).abs().max() < 1e-5)
        True
    """
    result = copy.deepcopy(network).eval()
    for name in ("fine", "coarse", "passed", "joined"):
        layers, kept = list(getattr(result, name)), []
        for layer in layers:
            if isinstance(layer, nn.BatchNorm2d):
                kept[-1] = fuse_conv_bn_eval(kept[-1], layer)
            else:
                kept.append(layer)
        setattr(result, name, nn.Sequential(*kept))
    return result.requires_grad_(False)
