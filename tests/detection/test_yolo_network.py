from __future__ import annotations

import pytest
import torch
from torch import nn

from eaip_prob.detection.yolo.network import YoloNetwork, YoloShape, folded
from eaip_prob.detection.yolo.packed import ready
from eaip_prob.errors import InputError


def test_at_full_width_it_has_the_weights_of_yolo_v2():
    with torch.device("meta"):
        network = YoloNetwork(YoloShape(1.0, 5, 80))
    numbers = sum(t.numel() for name, t in network.state_dict().items() if "num_batches" not in name)
    # The file yolov2.weights of Redmon and Farhadi for 80 classes: 203 934 260 bytes, of which 4 numbers are its head.
    assert numbers == 203_934_260 // 4 - 4
    assert network.num_layers == 31
    assert network.answer.out_channels == 425 and network.joined[0].in_channels == 1024 + 4 * 64


def lived_in(g: torch.Generator) -> YoloNetwork:
    """A network whose normalisations have seen images."""
    network = YoloNetwork(YoloShape(1 / 16), torch.Generator().manual_seed(0))
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            for values in (module.weight.data, module.running_var):
                values.copy_(0.5 + torch.rand(values.shape, generator=g))
            for values in (module.bias.data, module.running_mean):
                values.copy_(torch.randn(values.shape, generator=g))
    return network.eval()


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize("size", [(96, 64), (32, 128)])
def test_a_network_made_ready_says_the_same(size, layout):
    g = torch.Generator().manual_seed(2)
    network, made = lived_in(g), []
    before = {name: value.clone() for name, value in network.state_dict().items()}
    quick = ready(network, size)
    for _ in range(2):
        image = torch.rand(1, 3, size[1], size[0], generator=g).contiguous(memory_format=layout)
        with torch.inference_mode():
            made.append(quick(image))
            torch.testing.assert_close(made[-1], network(image), atol=1e-4, rtol=1e-4)
    assert not torch.equal(*made)
    assert all(torch.equal(value, network.state_dict()[name]) for name, value in before.items())


def test_without_onednn_the_plain_network_answers(monkeypatch):
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: False)
    g = torch.Generator().manual_seed(3)
    network, image = lived_in(g), torch.rand(1, 3, 64, 64, generator=g)
    quick = ready(network, (64, 64))
    assert isinstance(quick, YoloNetwork)
    with torch.inference_mode():
        torch.testing.assert_close(quick(image), network(image), atol=1e-4, rtol=1e-4)


def test_folding_leaves_the_answers_and_the_network():
    g = torch.Generator().manual_seed(1)
    network = lived_in(g)
    image = torch.rand(2, 3, 64, 96, generator=g)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    with torch.inference_mode():
        torch.testing.assert_close(folded(network)(image), network(image), atol=1e-4, rtol=1e-4)
    assert not any(isinstance(module, nn.BatchNorm2d) for module in folded(network).modules())
    assert all(torch.equal(value, network.state_dict()[name]) for name, value in before.items())


def test_a_cell_sees_the_finer_map_through_the_pass_through():
    network = YoloNetwork(YoloShape(1 / 16), torch.Generator().manual_seed(0)).eval()
    image = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        before = network(image)
        for module in network.coarse:
            if isinstance(module, nn.Conv2d):
                module.weight.zero_()  # nothing reaches the answers but through the reorganisation
        flat, other = network(image), network(image.flip(3))
    assert before.shape == (1, 45, 2, 2) and not torch.allclose(before, flat) and not torch.allclose(flat, other)


def test_weights_follow_from_the_generator_alone():
    one, other, third = (YoloNetwork(YoloShape(1 / 32), torch.Generator().manual_seed(s)) for s in (0, 0, 1))
    assert torch.equal(one.joined[0].weight, other.joined[0].weight)
    assert not torch.equal(one.joined[0].weight, third.joined[0].weight)


@pytest.mark.parametrize("arguments", [{"width": 0.0}, {"num_anchors": 0}, {"num_classes": 0}])
def test_bad_shapes_are_refused(arguments):
    with pytest.raises(InputError, match="width"):
        YoloShape(**arguments)
