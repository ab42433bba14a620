"""The views that a detector is trained and validated on, of the four demonstrated pieces of furniture (Fig. 10).

| set | instances |
|---|---|
| training | varied ones of each class, and the four pieces themselves in other colours |
| validation | others, from the same ranges |
| unusual | varied ones whose lengths lie outside these ranges |
| demonstrated | the four pieces themselves, as in `conf/object/` |

The objects that were never demonstrated (Fig. 11) are in none of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from eaip_prob.detection.labelled import LabelledImages
from eaip_prob.errors import InputError
from eaip_prob.simulation import AbstractObject, KinectModel, Rig
from eaip_prob.simulation.detector_views import DetectorViews

DEMONSTRATED: Mapping[str, str] = {  # object -> class
    "stepladder": "stepladder",
    "folding_table": "table",
    "office_chair": "chair",
    "brown_bookshelf": "bookshelf",
}
SETS = ("training", "validation", "unusual", "demonstrated")


def planned_views(
    rig: Rig,
    model: KinectModel,
    objects: Mapping[str, AbstractObject],
    numbers: Mapping[str, int],
    seed: int = 0,
    camera: str = "right",
) -> dict[str, DetectorViews]:
    """What to render, set by set.

    Args:
        rig: where the cameras stand.
        model: the camera.
        objects: the four demonstrated pieces, by name.
        numbers: of views in each set.
        seed: of everything random; the sets share nothing.
        camera: whose view it is.

    Raises:
        InputError: another set, another object, or a camera that the rig does not have.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> small = Intrinsics(48, 27, 26.5, 26.5, 23.4, 12.5)
        >>> rig = Rig({"right": (0.55, -1.75, 1.15)}, {"right": (0.95, 0.0, -0.15)})
        >>> model = KinectModel(small, small, (0.0, 0.0, 0.0))
        >>> planned_views(rig, model, {}, {"training": 8})["training"].num
        8
    """
    strange = sorted(set(numbers) - set(SETS)) + sorted(set(objects) - set(DEMONSTRATED))
    if strange or camera not in rig.positions:
        raise InputError(
            f"Expected sets among {SETS}, objects among {tuple(DEMONSTRATED)} and a camera among "
            f"{tuple(rig.positions)}, got {strange} and {camera!r}."
        )
    (x, y, z), (a, b, c) = rig.positions[camera], rig.targets[camera]
    things = {name: (DEMONSTRATED[name], thing) for name, thing in objects.items()}
    return {
        name: DetectorViews(
            number,
            10000 * seed + 1000 * SETS.index(name),
            model,
            (float(x), float(y), float(z)),
            (float(a), float(b), float(c)),
            things=things if name == "demonstrated" else {},
            pieces={label: thing for label, thing in things.values()} if name in ("training", "validation") else {},
            unusual=name == "unusual",
        )
        for name, number in numbers.items()
    }


def rendered_views(plans: Mapping[str, DetectorViews], folder: Path) -> dict[str, LabelledImages]:
    """The views of each set, from the folder, or rendered and written there.

    Args:
        plans: from `planned_views`.
        folder: where views are kept.

    Example:
        >>> rendered_views({}, Path("views"))
        {}
    """
    return {name: plan.views(folder) for name, plan in plans.items()}
