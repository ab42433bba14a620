"""From labelled views to a file of weights whose scores and box errors are measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from eaip_prob.detection.labelled import LabelledImages
from eaip_prob.detection.network_input import WHOLE
from eaip_prob.detection.validation import Judgement, calibration, judged
from eaip_prob.detection.yolo.anchors import anchors_from_boxes
from eaip_prob.detection.yolo.detector import YoloDetector
from eaip_prob.detection.yolo.network import CELL
from eaip_prob.detection.yolo.training import Trainer, Training
from eaip_prob.detection.yolo.weights_file import YoloSettings, write_weights

FILE = "furniture.safetensors"
_ALL = 0.001  # threshold that lets through what a calibration learns from


def settings_for(
    images: LabelledImages,
    width: float,
    input_size: Sequence[int],
    num_anchors: int,
    region: Sequence[float] = WHOLE,
    seed: int = 0,
) -> YoloSettings:
    """Settings with anchors that fit the boxes of the images.

    Args:
        images: to be trained on.
        width: factor on all channels of YOLO v2.
        input_size: (width, height) of the network's input, px.
        num_anchors: A.
        region: (left, top, right, bottom) of the part of an image that the network sees, shares of its sides.
        seed: of the search for anchors.

    Example:
        >>> boxes = np.array([[30.0, 20.0, 10.0, 20.0], [30.0, 20.0, 20.0, 10.0]])
        >>> nowhere = np.zeros((2, 45, 80), bool)
        >>> images = LabelledImages(np.zeros((2, 45, 80, 3), np.uint8), boxes, np.array([0, 1]), nowhere)
        >>> sorted(settings_for(images, 0.25, (160, 96), 2).anchors)
        [(0.625, 1.25), (1.25, 0.625)]
    """
    images = images.within(region)
    sizes = images.box[:, 2:] * min(input_size[0] / images.size[0], input_size[1] / images.size[1]) / CELL
    anchors = anchors_from_boxes(sizes, num_anchors, np.random.default_rng(seed))
    pairs = tuple((float(wide), float(high)) for wide, high in anchors)
    left, top, right, bottom = (float(share) for share in region)
    return YoloSettings(width, (int(input_size[0]), int(input_size[1])), pairs, region=(left, top, right, bottom))


def train(
    images: LabelledImages, settings: YoloSettings, plan: Training, folder: Path, progress: bool | None = None
) -> Trainer:
    """A trained network; goes on from the state in the folder, if there is one.

    Args:
        images: to learn from.
        settings: of the network.
        plan: of the training.
        folder: where the state is kept.
        progress: whether to show a bar; None for in a terminal only.

    Example:
        >>> images = LabelledImages(
        ...     np.zeros((2, 36, 64, 3), np.uint8), np.tile([30.0, 18.0, 20.0, 20.0], (2, 1)), np.array([0, 1]),
        ...     np.ones((2, 36, 64), bool),
        ... )
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     plan, settings = Training(epochs=1), YoloSettings(1 / 32, (64, 32), ((0.6, 0.6),))
        ...     len(train(images, settings, plan, Path(folder)).losses)
        1
    """
    from tqdm import tqdm

    trainer = Trainer(images.within(settings.region), settings, plan, folder)
    hidden = None if progress is None else not progress
    with tqdm(total=plan.epochs, initial=len(trainer.losses), desc="epochs", disable=hidden) as bar:
        for _, loss in trainer.epochs():
            bar.set_postfix(loss=f"{loss:.3f}")
            bar.update()
    return trainer


def calibrated(
    trainer: Trainer, views: Mapping[str, LabelledImages], folder: Path, notes: Mapping[str, str]
) -> tuple[Path, dict[str, Judgement]]:
    """The file of the averaged weights, and what they say of each set of views.

    Scores are calibrated, and errors of boxes measured, on the sets that hold varied instances.

    Args:
        trainer: at its end.
        views: by set; `validation` and `unusual` are measured on.
        folder: where the file is written.
        notes: for people who read the file.

    Example:
        >>> import inspect
        >>> list(inspect.signature(calibrated).parameters)
        ['trainer', 'views', 'folder', 'notes']
    """
    path = write_weights(folder / FILE, trainer.averaged, trainer.settings, notes)
    raw = {name: judged(YoloDetector(path, threshold=_ALL), views[name]) for name in ("validation", "unusual")}
    slope, offset = calibration(
        np.concatenate([one.score for one in raw.values()]), np.concatenate([one.right for one in raw.values()])
    )
    errors = np.concatenate([one.error[one.right] for one in raw.values()])
    spread = np.sqrt(np.mean(errors**2, 0)).round(5).tolist() if len(errors) else trainer.settings.box_errors
    settings = replace(
        trainer.settings, score_slope=round(slope, 4), score_offset=round(offset, 4), box_errors=tuple(spread)
    )
    write_weights(path, trainer.averaged, settings, notes)
    detector = YoloDetector(path)
    return path, {name: judged(detector, images) for name, images in views.items()}
