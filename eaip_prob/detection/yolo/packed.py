"""A trained network made ready for one size of image, for answers within a frame's time on one core.

torch's own `Conv2d` brings its weights into the processor's layout at each call, which takes as long as the convolution
itself where maps are small. Here oneDNN, torch's library for that, lays them out once, and the leaky rectifier is part
of the convolution. Numbers agree with those of the network to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from eaip_prob.detection.yolo.network import YoloNetwork, folded

_Layer = Callable[[Tensor], Tensor]


def ready(network: YoloNetwork, size: tuple[int, int]) -> Callable[[Tensor], Tensor]:
    """Answers of a network to one image at a time, computed faster than by the network itself.

    Args:
        network: trained; left as it is.
        size: (width, height) of the images, px; multiples of 32.

    Returns:
        a function of (1, 3, H, W), RGB from 0 to 1, best with channels last in memory, to be called without gradients.

    Example:
        >>> from eaip_prob.detection.yolo.network import YoloShape
        >>> network = YoloNetwork(YoloShape(1 / 32), torch.Generator().manual_seed(0)).eval()
        >>> image = torch.rand(1, 3, 32, 64, generator=torch.Generator().manual_seed(1))
        >>> with torch.inference_mode():
        ...     bool((network(image) - ready(network, (64, 32))(image)).abs().max() < 1e-5)
        True
    """
    plain = folded(network)
    plain.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]  # missing in torch's stubs
    return _Packed(plain, size) if torch.backends.mkldnn.is_available() else plain


class _Packed:
    def __init__(self, network: YoloNetwork, size: tuple[int, int]) -> None:
        shape = (size[1], size[0])
        self._fine, shape = _packed(network.fine, shape)
        self._passed, _ = _packed(network.passed, shape)
        self._coarse, shape = _packed(network.coarse, shape)
        self._last, _ = _packed([*network.joined, network.answer], shape)

    def __call__(self, image: Float[Tensor, "1 3 height width"]) -> Float[Tensor, "1 answers rows columns"]:
        fine = _run(self._fine, image)
        passed = nn.functional.pixel_unshuffle(_run(self._passed, fine), 2)
        return _run(self._last, torch.cat([passed, _run(self._coarse, fine)], 1))


class _Convolution:
    """A convolution with its weights laid out for maps of one size, and a leaky rectifier unless the slope is None."""

    def __init__(self, layer: nn.Conv2d, shape: tuple[int, int], slope: float | None) -> None:
        inside: list[Any] = [1, layer.in_channels, *shape]
        onednn: Any = torch._C._nn  # pyright: ignore[reportAttributeAccessIssue]  # missing in torch's stubs
        self._weight = onednn.mkldnn_reorder_conv2d_weight(
            layer.weight.detach().to_mkldnn(), layer.padding, layer.stride, layer.dilation, layer.groups, inside
        )
        self._bias, self._around = layer.bias, (layer.padding, layer.stride, layer.dilation, layer.groups)
        self._after = ("none", [], "") if slope is None else ("leaky_relu", [slope], "")

    def __call__(self, value: Tensor) -> Tensor:
        return torch.ops.mkldnn._convolution_pointwise(value, self._weight, self._bias, *self._around, *self._after)


def _run(layers: Iterable[_Layer], value: Tensor) -> Tensor:
    for layer in layers:
        value = layer(value)
    return value


def _packed(layers: Iterable[nn.Module], shape: tuple[int, int]) -> tuple[list[_Layer], tuple[int, int]]:
    """Functions in the place of layers, and (rows, columns) after them."""
    result, waiting = [], list(layers)
    while waiting:
        layer = waiting.pop(0)
        if isinstance(layer, nn.Conv2d):
            after = waiting.pop(0) if waiting and isinstance(waiting[0], nn.LeakyReLU) else None
            result.append(_Convolution(layer, shape, after.negative_slope if isinstance(after, nn.LeakyReLU) else None))
        else:
            result.append(layer)
            shape = (shape[0] // 2, shape[1] // 2)
    return result, shape
