"""Labelled rendered views of furniture, made once and kept on disk.

Each view has its own instance of a class, room, light and camera pose. Rays are those of an image of twice the size:
a view of 480 x 270 px costs, and shows, what one of 960 x 540 px does that is reduced by two.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from eaip_prob.data.archive import read_arrays, write_arrays
from eaip_prob.detection.base import CLASSES
from eaip_prob.detection.labelled import LabelledImages
from eaip_prob.errors import InputError
from eaip_prob.simulation.furniture import AbstractObject
from eaip_prob.simulation.kinect import Kinect, KinectModel, looking_at
from eaip_prob.simulation.render import View, render_color, render_depth
from eaip_prob.simulation.scene import Scene
from eaip_prob.simulation.varied_draw import Draw
from eaip_prob.simulation.varied_furniture import repainted, varied
from eaip_prob.simulation.varied_room import varied_lighting, varied_scene

_FORMAT = "eaip_prob detector views 5"
_VISIBLE, _INSIDE = 0.25, 0.7  # least share of the object that is visible, and of its box that lies in the image
_ATTEMPTS = 50
_REPAINTED = 0.3  # share of views that show the piece that was demonstrated, in other colours
_PAIRED = 0.4  # share of the chairs and tables that have the same plate and legs as the table or chair beside them
_RULES = (_FORMAT, _VISIBLE, _INSIDE, _REPAINTED, _PAIRED)


@dataclass(frozen=True)
class DetectorViews:
    """What is rendered: as many views of each class, the classes in turn.

    Args:
        num: of views.
        seed: of everything random.
        model: the camera; its colour image is rendered.
        position: (3,), where the camera stands, m.
        target: (3,), what it looks at, m.
        things: name -> (class, object), to be shown in turn; varied instances of every class if empty.
        pieces: class -> the piece of furniture that was demonstrated, which is shown in other colours in three tenths
            of the views of its class.
        unusual: varied instances from outside the ranges and combinations of the usual ones.
        jitter: standard deviation of the camera's position and target, m.
        oversample: n, for n by n rays a pixel.

    Raises:
        InputError: no views, or a class that is none.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> small = Intrinsics(48, 27, 26.5, 26.5, 23.4, 12.5)
        >>> model = KinectModel(small, small, (-0.05, 0.0, 0.0))
        >>> plan = DetectorViews(4, 0, model, (0.55, -1.75, 1.15), (0.95, 0.0, -0.15))
        >>> plan.render(1).names
        ['stepladder']
    """

    num: int
    seed: int
    model: KinectModel
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    things: Mapping[str, tuple[str, AbstractObject]] = field(default_factory=dict)
    pieces: Mapping[str, AbstractObject] = field(default_factory=dict)
    unusual: bool = False
    jitter: float = 0.015
    oversample: int = 2

    def __post_init__(self) -> None:
        strange = sorted({*self.pieces, *(label for label, _ in self.things.values())} - set(CLASSES))
        if self.num < 1 or strange:
            raise InputError(f"Expected at least one view, of the classes {CLASSES}, got {self.num} and {strange}.")

    def key(self) -> str:
        """What the views follow from, as 32 hexadecimal digits."""
        digest = hashlib.sha256(
            repr((*_RULES, *(v for k, v in vars(self).items() if k not in ("things", "pieces")))).encode()
        )
        shown = [*self.things.items(), *((label, (label, piece)) for label, piece in self.pieces.items())]
        for name, (label, thing) in shown:
            mesh = thing.mesh()
            digest.update(repr((name, label)).encode())
            for array in (mesh.vertices, mesh.triangles, mesh.color):
                digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:32]

    def names(self) -> list[str]:
        """What each view shows: the name of an object, or the class of a varied instance."""
        kinds = list(self.things) or list(CLASSES)
        return [kinds[index % len(kinds)] for index in range(self.num)]

    def views(self, folder: Path) -> LabelledImages:
        """All views, from the folder, or rendered (about 0.2 s a view of 480 x 270 px) and written there.

        Args:
            folder: where views are kept, a file for each configuration.

        Raises:
            DataFileError: the file in the folder is damaged.
        """
        from tqdm import tqdm

        path = Path(folder) / f"views-{self.key()}.npz"
        if path.is_file():
            return LabelledImages(**read_arrays(path))
        pictures = [self.render(index) for index in tqdm(range(self.num), "views", disable=None, leave=False)]
        arrays = {name: np.concatenate([getattr(one, name) for one in pictures]) for name in vars(pictures[0])}
        write_arrays(path, arrays)
        return LabelledImages(**arrays)

    def render(self, index: int) -> LabelledImages:
        """One view, the same whatever else is rendered; drawn anew while too little of the object can be seen.

        Args:
            index: of the view.

        Raises:
            InputError: the object cannot be seen from there.
        """
        name, generator = self.names()[index], np.random.default_rng([self.seed, index])
        draw = Draw(generator)
        for _ in range(_ATTEMPTS):
            label, thing = self._thing(name, index // len(CLASSES), generator)
            view, scene = self._view(generator), varied_scene(thing, draw)
            visible, box = whole_box(scene, view)
            if box is not None:
                image = render_color(scene, view, varied_lighting(draw), self.oversample)
                return LabelledImages(image[None], box[None], np.array([CLASSES.index(label)]), visible[None])
        raise InputError(f"Expected {name} in view of a camera at {self.position}, got none in {_ATTEMPTS} tries.")

    def _thing(self, name: str, group: int, generator: np.random.Generator) -> tuple[str, AbstractObject]:
        if self.things:
            return self.things[name]
        draw = Draw(generator, self.unusual)
        if name in self.pieces and draw.chance(_REPAINTED):
            return name, repainted(self.pieces[name], name, draw)
        shared = Draw(np.random.default_rng([self.seed, group, 1]), self.unusual)  # the same for the classes of a group
        return name, varied(name, draw, shared if shared.chance(_PAIRED) else None)

    def _view(self, generator: np.random.Generator) -> View:
        position = np.asarray(self.position) + self.jitter * generator.normal(size=3)
        target = np.asarray(self.target) + self.jitter * generator.normal(size=3)
        return Kinect("detector", self.model, looking_at(position.tolist(), target.tolist())).color_view


def whole_box(scene: Scene, view: View) -> tuple[Bool[np.ndarray, "height width"], Float[np.ndarray, "4"] | None]:
    """Pixels that show the part `thing`, and the box of all of it, also where something stands before it.

    Args:
        scene: with a part of that name.
        view: the camera.

    Returns:
        the pixels, and centre column, centre row, width and height, px, cut off at the image's edges; None where less
        than a quarter of the object is visible or less than 70 % of its box lies in the image.

    Example:
        >>> from eaip_prob.data.frames import Intrinsics
        >>> from eaip_prob.simulation import Part, box
        >>> scene = Scene([Part("thing", box((1.0, 1.0, 1.0), (1, 0, 0)).at(z=2.5))])
        >>> whole_box(scene, View(Intrinsics(41, 31, 40.0, 40.0, 20.0, 15.0), np.eye(4)))[1].round(6).tolist()
        [20.0, 15.0, 20.0, 20.0]
    """
    index = scene.index("thing")
    part, camera = scene.parts[index], view.intrinsics
    visible = render_depth(scene, view).instance == index
    T = view.T_world_camera
    pixels = camera.project((part.mesh.vertices - T[:3, 3]) @ T[:3, :3])
    if np.isnan(pixels).any():
        return visible, None
    edges = np.stack([pixels.min(0), pixels.max(0)])
    inside = edges.clip([-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5])
    size = inside[1] - inside[0]
    alone = render_depth(Scene([part]), view).hit.sum()
    if visible.sum() < max(_VISIBLE * alone, 1) or size.prod() < _INSIDE * (edges[1] - edges[0]).prod():
        return visible, None
    return visible, np.concatenate([inside.mean(0), size])
