"""The room and its objects as pictures: Fig. 9, 10 and 11 of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from eaip_prob.data.frames import Intrinsics, inverse
from eaip_prob.figures import new_figure, save_figure
from eaip_prob.robot import baxter_left_arm, baxter_right_arm, follow, link_points
from eaip_prob.simulation import Kinect, Lighting, Mesh, Part, Scene, box, looking_at
from eaip_prob.simulation.cloth import ClothBag
from eaip_prob.simulation.cloth_contact import Obstacle
from eaip_prob.simulation.render import View, render_color
from eaip_prob.tasks.bag_covering.cases import Case, Room
from eaip_prob.tasks.bag_covering.motion import RATE
from eaip_prob.tasks.bag_covering.outcome_pictures import spoken

_PLATFORM = Intrinsics(1200, 900, 1180.0, 1180.0, 599.5, 449.5)
_PLATFORM_EYE, _PLATFORM_TARGET = (-2.25, 3.15, 1.5), (0.72, 0.0, 0.28)
_OBJECT = Intrinsics(460, 460, 800.0, 800.0, 229.5, 229.5)
_EYE, _TARGET = (2.05, -1.75, 1.25), (0.0, 0.0, 0.46)
_LAMP = (1.5, -0.6, 2.6)
_MIDWAY = 0.5  # share of the motion at which the platform is shown
_UNIT = (0.249, 0.066, 0.067)  # m, width, depth and height of a Kinect v2
_RED = "#d00000"


def draw_platform(folder: Path, case: Case, cameras: Sequence[Kinect]) -> None:
    """Fig. 9: robot, object, partner, bag and cameras, half-way through a motion.

    Args:
        folder: of the run.
        case: a trial.
        cameras: of the room, marked in red.
    """
    scene = _platform(case, cameras)
    view = View(_PLATFORM, looking_at(_PLATFORM_EYE, _PLATFORM_TARGET))
    figure, (ax,) = new_figure(width=8.0, height=6.0)
    _show(ax, render_color(scene, view, Lighting(background=(0.93, 0.94, 0.96)), oversample=2))
    for number, unit in enumerate(cameras, 1):
        _mark(ax, _pixel(view, _body(unit).extent().mean(0)), f"Kinect {number} ({unit.name})")
    words = {"robot": "Baxter", "person": "partner"}
    for part in scene.parts:
        if part.name in words:
            highest = part.mesh.vertices[part.mesh.vertices[:, 2].argmax()]
            ax.annotate(words[part.name], _pixel(view, highest, up=26.0), ha="center", fontsize=10, fontweight="bold")
    ax.set_title(f"A partner and Baxter cover the {spoken(case.site.name)}")
    save_figure(figure, folder, "fig_9_platform")


def draw_objects(folder: Path, name: str, room: Room, things: Sequence[str]) -> None:
    """Fig. 10 and 11: objects side by side at one scale, with their sizes.

    Args:
        folder: of the run.
        name: of the figure.
        room: which has the objects.
        things: their names.
    """
    if not things:
        return
    columns = min(len(things), 4)
    figure, axes = new_figure(columns, -(-len(things) // columns), width=2.9, height=3.3)
    for number, (ax, thing) in enumerate(zip(axes, things, strict=False)):
        mesh = room.things[thing].mesh()
        _show(ax, _portrait(mesh))
        depth, width, height = np.diff(mesh.extent(), axis=0)[0]
        size = f"{width:.2f} m wide, {depth:.2f} m deep, {height:.2f} m high"
        ax.set_title(f"{chr(ord('a') + number)}  {spoken(thing)}\n{size}", fontsize=9)
    for ax in axes[len(things) :]:
        ax.remove()
    save_figure(figure, folder, name)


def arms_of(left: Float[np.ndarray, "3"], right: Float[np.ndarray, "3"]) -> list[Float[np.ndarray, "points 3"]]:
    """Both arms as lines from the shoulder to where the grippers are, m.

    Args:
        left: (3,), tip of the left gripper, m.
        right: (3,), of the right one, m.

    Example:
        >>> [points.shape for points in arms_of(np.array([0.42, -0.6, -0.15]), np.array([0.42, -0.74, -0.5]))]
        [(9, 3), (9, 3)]
    """
    pairs = ((baxter_left_arm(), left), (baxter_right_arm(), right))
    return [link_points(arm, follow(arm, np.asarray(tip, float)[None]).joints[0]) for arm, tip in pairs]


def _platform(case: Case, cameras: Sequence[Kinect]) -> Scene:
    motion, room = case.motion, case.site.room
    step = round(_MIDWAY * (len(motion.time) - 1))
    grippers = np.stack([motion.gripper[step], motion.still])
    scene = room.scene(motion.hands[step], grippers)
    parts = [part for part in scene.parts if part.name not in ("robot", "bag")]
    if room.robot is not None:
        arms = [link_points(baxter_left_arm(), _joints(case, step)), arms_of(grippers[0], grippers[1])[1]]
        parts.append(Part("robot", room.robot.mesh(grippers, arms)))
    units = [Part(f"unit {unit.name}", _body(unit)) for unit in cameras]
    return Scene([*parts, Part("bag", _carried(case, step)), *units])


def _joints(case: Case, step: int) -> Float[np.ndarray, "joints"]:
    return follow(baxter_left_arm(), case.motion.gripper[: step + 1]).joints[-1]


def _carried(case: Case, last: int) -> Mesh:
    """The bag as it hangs after a part of the motion."""
    bag, motion = ClothBag(), case.motion
    around = Obstacle.around(case.site.mesh, case.site.room.floor)
    still = np.broadcast_to(motion.still, motion.gripper.shape)
    mouth = np.stack([motion.gripper, still, motion.hands[:, 0], motion.hands[:, 1]], 1)
    state = bag.init(mouth[0], around)
    for handles in mouth[1 : last + 1]:
        state = bag.step(state, handles, 1.0 / RATE, around)
    return bag.mesh(state)


def _body(unit: Kinect) -> Mesh:
    # The lenses look along z of the camera; the body lies behind them.
    width, depth, height = _UNIT
    return box((width, height, depth), (0.08, 0.08, 0.09)).at(z=-depth / 2.0).moved(unit.T_world_camera)


def _portrait(mesh: Mesh) -> UInt8[np.ndarray, "height width 3"]:
    low, high = mesh.extent()
    middle = (low + high) / 2.0
    floor = box((30.0, 30.0, 0.02), (0.80, 0.80, 0.79)).at(z=-0.01)
    scene = Scene([Part("floor", floor), Part("thing", mesh.at(-middle[0], -middle[1], -low[2]))])
    view = View(_OBJECT, looking_at(_EYE, _TARGET))
    return render_color(scene, view, Lighting(lamp=_LAMP, background=(0.93, 0.94, 0.96)), oversample=3)


def _pixel(view: View, point: Float[np.ndarray, "3"], up: float = 0.0) -> tuple[float, float]:
    """Column and row at which a point is seen, or so many pixels above it."""
    T = inverse(view.T_world_camera)
    column, row = view.intrinsics.project(T[:3, :3] @ point + T[:3, 3]).tolist()
    return column, row - up


def _show(ax, image: np.ndarray) -> None:  # noqa: ANN001
    ax.imshow(image)
    ax.set_axis_off()


def _mark(ax, at: tuple[float, float], text: str) -> None:  # noqa: ANN001
    from matplotlib.patches import Ellipse

    ax.add_patch(Ellipse(at, 90, 60, fill=False, edgecolor=_RED, linewidth=2.0))
    ax.annotate(text, (at[0], at[1] - 38), ha="center", va="bottom", color=_RED, fontsize=10, fontweight="bold")
