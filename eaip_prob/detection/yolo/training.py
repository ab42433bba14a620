"""Training of YOLO v2 on labelled images, which goes on where it was stopped with the same result."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from eaip_prob.detection.labelled import LabelledImages
from eaip_prob.detection.yolo.augmentation import Augmentation
from eaip_prob.detection.yolo.batches import Batches
from eaip_prob.detection.yolo.checkpoint import read_checkpoint, write_checkpoint
from eaip_prob.detection.yolo.decoding import answers
from eaip_prob.detection.yolo.loss import LossScales, Targets, yolo_loss
from eaip_prob.detection.yolo.network import YoloNetwork
from eaip_prob.detection.yolo.weights_file import YoloSettings
from eaip_prob.errors import InputError


@dataclass(frozen=True)
class Training:
    """How a network is trained: AdamW, a rate that rises for an epoch and falls along a cosine, averaged weights.

    Args:
        epochs: times that every image is seen.
        batch: images a step.
        near: share of the epochs, the first ones, in which only what is near an object is shown, at the same scale: a
            third of the computation for most of what there is to learn. The epochs after them change the images less.
        near_size: (width, height) of what is shown then, px; multiples of 32.
        rate: largest learning rate.
        decay: of the weights.
        average: share of the averaged weights that a step keeps.
        augmentation: of the images.
        scales: of the parts of the loss.
        half: compute in bfloat16 where that suffices, twice as fast on processors that know it.
        seed: of everything random.

    Raises:
        InputError: no epochs, an empty batch, or a rate not above zero.

    Example:
        >>> Training(epochs=3, batch=8).epochs
        3
    """

    epochs: int = 60
    batch: int = 8
    near: float = 0.6
    near_size: tuple[int, int] = (128, 128)
    rate: float = 2e-3
    decay: float = 0.02
    average: float = 0.985
    augmentation: Augmentation = field(default_factory=Augmentation)
    scales: LossScales = field(default_factory=LossScales)
    half: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch < 1 or not self.rate > 0 or not 0 <= self.average < 1:
            raise InputError(
                f"Expected at least one epoch and one image a step, a rate above zero and an average from 0 to below "
                f"1, got {self}."
            )


class Trainer:
    """A network on its way: `epochs()` trains, and keeps the state on disk after each.

    Args:
        images: to learn from.
        settings: of the network.
        plan: of the training.
        folder: where the state is kept; nowhere if None.

    Raises:
        DataFileError: the folder holds the state of another training, or a damaged one.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> images = LabelledImages(
        ...     rng.integers(0, 255, (4, 36, 64, 3), np.uint8), np.tile([30.0, 18.0, 20.0, 20.0], (4, 1)), np.arange(4),
        ...     np.ones((4, 36, 64), bool),
        ... )
        >>> trainer = Trainer(images, YoloSettings(1 / 32, (64, 32), ((0.6, 0.6),)), Training(epochs=2, batch=2))
        >>> [epoch for epoch, loss in trainer.epochs()], len(trainer.losses)
        ([0, 1], 2)
    """

    def __init__(
        self, images: LabelledImages, settings: YoloSettings, plan: Training, folder: Path | None = None
    ) -> None:
        self.images, self.settings, self.plan = images, settings, plan
        self.network = YoloNetwork(settings.shape, torch.Generator().manual_seed(plan.seed))
        self.network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]  # missing in torch's stubs
        self.averaged = YoloNetwork(settings.shape)
        self.averaged.load_state_dict(self.network.state_dict())
        self.losses: list[float] = []
        self._near = Batches(images, self._scale(), plan.augmentation)
        self._far = Batches(images, self._scale(), plan.augmentation.calmer())
        decayed = [weight for weight in self.network.parameters() if weight.ndim > 1]
        plain = [weight for weight in self.network.parameters() if weight.ndim == 1]
        groups = [{"params": decayed, "weight_decay": plan.decay}, {"params": plain, "weight_decay": 0.0}]
        self._optimizer = torch.optim.AdamW(groups, lr=plan.rate, fused=True)
        self._steps = math.ceil(len(images) / plan.batch)
        self._path = None if folder is None else Path(folder) / "training.safetensors"
        self._networks = {"network": self.network, "averaged": self.averaged}
        if self._path is not None and self._path.is_file():
            self.losses = read_checkpoint(self._path, self._networks, self._optimizer, self._key())

    def epochs(self) -> Iterator[tuple[int, float]]:
        """Number and mean loss of each epoch as it ends."""
        for epoch in range(len(self.losses), self.plan.epochs):
            self.losses.append(self._epoch(epoch))
            if self._path is not None:
                write_checkpoint(self._path, self._networks, self._optimizer, self.losses, self._key())
            yield epoch, self.losses[-1]
        self.averaged.eval()

    def _key(self) -> str:
        digest = hashlib.sha256(repr((self.settings, self.plan)).encode())
        for array in (self.images.image, self.images.box, self.images.label, self.images.visible):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def _epoch(self, epoch: int) -> float:
        order, losses = np.random.default_rng([self.plan.seed, epoch]).permutation(len(self.images)), []
        near = epoch < round(self.plan.near * self.plan.epochs)
        size = self.plan.near_size if near else self.settings.input_size
        make = (self._near if near else self._far).batch
        parts = [order[start : start + self.plan.batch] for start in range(0, len(order), self.plan.batch)]
        self.network.train()
        # The next batch is made on the other core; each has a generator of its own, so that nothing depends on when.
        with ThreadPoolExecutor(1) as maker:
            coming = maker.submit(make, parts[0], size, self._generator(epoch, 0))
            for step in range(len(parts)):
                image, truth = coming.result()
                if step + 1 < len(parts):
                    coming = maker.submit(make, parts[step + 1], size, self._generator(epoch, step + 1))
                losses.append(self._step(image, truth, epoch * len(parts) + step))
        return float(np.mean(losses))

    def _scale(self) -> float:
        size, images = self.settings.input_size, self.images
        return min(size[0] / images.size[0], size[1] / images.size[1])

    def _generator(self, epoch: int, step: int) -> np.random.Generator:
        return np.random.default_rng([self.plan.seed, epoch, 1 + step])

    def _step(self, image: Tensor, truth: Targets, number: int) -> float:
        for group in self._optimizer.param_groups:
            group["lr"] = self.plan.rate * self._share(number)
        anchors = torch.tensor(self.settings.anchors)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.plan.half):
            raw = self.network(image)
        loss = yolo_loss(answers(raw.float(), anchors), truth, anchors, self.plan.scales)
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self._optimizer.step()
        kept = min(self.plan.average, (1.0 + number) / (10.0 + number))
        with torch.no_grad():
            mean, now = (_real(network) for network in (self.averaged, self.network))
            torch._foreach_lerp_(mean, now, 1.0 - kept)  # pyright: ignore[reportPrivateImportUsage]
        return float(loss.detach())

    def _share(self, step: int) -> float:
        total, warm = self.plan.epochs * self._steps, self._steps
        if step < warm:
            return (step + 1) / warm
        return 0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * (step - warm) / max(total - warm, 1)))


def _real(network: YoloNetwork) -> list[Tensor]:
    """Weights and running moments, without the counters of batches."""
    return [value for value in network.state_dict().values() if value.is_floating_point()]
