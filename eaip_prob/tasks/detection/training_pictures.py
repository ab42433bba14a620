"""What a detector learnt from and says of new views, and how its loss fell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eaip_prob.detection.base import AbstractImageDetector
from eaip_prob.detection.labelled import LabelledImages
from eaip_prob.figures import new_figure, save_figure
from eaip_prob.tasks.detection.outlines import outline

if TYPE_CHECKING:
    pass

_TRUE, _RIGHT, _WRONG = "#FFFFFF", "#56B4E9", "#E69F00"


def draw_boxes(
    folder: Path, name: str, images: LabelledImages, detector: AbstractImageDetector | None = None, num: int = 12
) -> Path:
    """The first views of a set with their true boxes, dashed and white, and what a detector says of them.

    Args:
        folder: of the run.
        name: of the figure.
        images: labelled views.
        detector: whose boxes are drawn too, blue where the class is right and orange where not; none if None.
        num: of views.
    """
    figure, axes = new_figure(4, -(-min(num, len(images)) // 4), width=3.2, height=1.95)
    for ax in axes:
        ax.set_axis_off()
    for index, ax in zip(range(min(num, len(images))), axes, strict=False):
        ax.imshow(images.image[index])
        outline(ax, images.box[index], _TRUE, "--")
        title = images.names[index]
        if detector is not None:
            found = detector.detect_image(images.image[index])
            title += ": nothing found" if not len(found) else ""
            for place, label in reversed(list(enumerate(found.labels))):
                outline(ax, found.box[place], _RIGHT if label == images.names[index] else _WRONG, "-")
                title = f"{images.names[index]}: {label} {found.score[place]:.2f}" if place == 0 else title
        ax.set_title(title, fontsize=8)
    return save_figure(figure, folder, name)


def draw_losses(folder: Path, losses: Sequence[float]) -> Path:
    """The mean loss of each epoch.

    Args:
        folder: of the run.
        losses: one an epoch.
    """
    figure, (ax,) = new_figure()
    ax.plot(np.arange(1, len(losses) + 1), losses, color="#0072B2")
    ax.set(xlabel="epoch", ylabel="loss of YOLO v2 (mean over images)", yscale="log", title="training")
    return save_figure(figure, folder, "loss")
