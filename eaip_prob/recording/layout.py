"""The layout with which the viewer opens a recording: paths beside plots beside the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import rerun.blueprint as rrb

from eaip_prob.recording.records import Layout, Moment
from eaip_prob.recording.rerun_scene import IMAGE_BOXES
from eaip_prob.recording.rerun_sensors import COLOR_CAMERA, COLOR_IMAGE, DEPTH_CAMERA, DEPTH_IMAGE

Bounds = tuple[tuple[float, float], tuple[float, float]]
Point = tuple[float, float, float]

_MARGIN = 0.08
# Where the eye stands and looks to see the robot's workspace, m in the robot's frame: from the front left above.
_EYE, _LOOKS_AT = (-0.9, 2.1, 1.5), (1.0, 0.0, 0.0)
_NEAR_EYE, _NEAR_LOOKS_AT = (0.7, 0.55, 0.65), (1.25, 0.0, 0.3)


@dataclass
class Sensed:
    """Entities in space, in the order in which they came, that some layouts show in views of their own.

    Args:
        cameras: whose images are shown.
        clouds: kept apart from what the viewer projects back.
        markers: drawn over the images as well.
        surfaces: kept apart from clouds, which show the same things.
    """

    cameras: list[str] = field(default_factory=list)
    clouds: list[str] = field(default_factory=list)
    markers: list[str] = field(default_factory=list)
    surfaces: list[str] = field(default_factory=list)


_NOTHING = Sensed()


def viewer_blueprint(
    layout: Layout,
    bounds: Bounds | None,
    last: Moment | None,
    sensed: Sensed = _NOTHING,
) -> rrb.Blueprint:
    """The rerun blueprint of a layout.

    Args:
        layout: what to show.
        bounds: ((x, y) smallest, (x, y) largest) of the plane, y up, or None for the viewer's own choice.
        last: where the timelines end, so that all plots have one horizontal axis, or None where it is not known yet.
        sensed: for which entities there are views of their own.
    """
    axis = _axis(layout.timeline, last)
    plots = [_plot_view(entity, title, axis) for entity, title in layout.plots.items()]
    report = rrb.TextDocumentView(origin="/report", name="Report")
    if layout.kind == "plots":
        shown = rrb.Grid(*plots, report)
    elif layout.kind == "cameras":
        shown = _beside_images(sensed, report, plots)
    elif layout.kind == "workspace":
        shown = _above_images(sensed, report, plots)
    else:
        paths = _plane_view(layout.bounds or bounds) if layout.kind == "plane" else _space_view()
        left = rrb.Vertical(paths, report, row_shares=[3.0, 1.0])
        shown = rrb.Horizontal(left, rrb.Vertical(*plots)) if plots else left
    return rrb.Blueprint(
        shown,
        rrb.TimePanel(state="collapsed", timeline=layout.timeline, play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _plane_view(bounds: Bounds | None) -> rrb.Spatial2DView:
    # The origin is the root, above the transform at /plane that mirrors y: a view with origin /plane would not see it.
    view = rrb.Spatial2DView
    if bounds is None:
        return view(origin="/", contents="/plane/**", name="Paths [px], y up")
    (left, bottom), (right, top) = bounds
    margin = _MARGIN * max(right - left, top - bottom, 1e-6)
    visible = rrb.VisualBounds2D(x_range=[left - margin, right + margin], y_range=[-top - margin, -bottom + margin])
    return view(origin="/", contents="/plane/**", name="Paths [px], y up", visual_bounds=visible)


def _space_view() -> rrb.Spatial3DView:
    return rrb.Spatial3DView(origin="/space", name="Paths [m], z up")


def _beside_images(sensed: Sensed, report: rrb.View, plots: Sequence[rrb.View]) -> rrb.Horizontal:
    scene, marks = _scene_views(sensed)
    below = rrb.Horizontal(marks, report, column_shares=[1.2, 1.0])
    columns: list[rrb.Container] = [rrb.Vertical(scene, below, row_shares=[2.0, 1.0])]
    shares = [2.4]
    if sensed.cameras:
        columns.append(_image_views(sensed))
        shares.append(1.0)
    if plots:
        columns.append(rrb.Vertical(*plots))
        shares.append(1.2)
    return rrb.Horizontal(*columns, column_shares=shares)


def _above_images(sensed: Sensed, report: rrb.View, plots: Sequence[rrb.View]) -> rrb.Horizontal:
    """Surfaces, with clouds in their stead behind a tab; images below, report and curves beside."""
    flat = [f"{camera}/{image}" for camera in sensed.cameras for image in (DEPTH_IMAGE, COLOR_IMAGE, IMAGE_BOXES)]
    scene = rrb.Tabs(
        _scene_view("Workspace [m], z up", [*flat, *sensed.clouds], _EYE, _LOOKS_AT, grid=False),
        _scene_view("Seen by the cameras [m], z up", [*flat, *sensed.surfaces], _EYE, _LOOKS_AT, grid=False),
        active_tab=0,
    )
    images = [_image_view(camera, "Colour", COLOR_CAMERA, []) for camera in sensed.cameras]
    left = rrb.Vertical(scene, rrb.Horizontal(*images), row_shares=[2.6, 1.0]) if images else scene
    right = rrb.Vertical(report, *plots, row_shares=[1.5, *(1.0 for _ in plots)])
    return rrb.Horizontal(left, right, column_shares=[2.4, 1.0])


def _scene_views(sensed: Sensed) -> tuple[rrb.Tabs, rrb.Spatial3DView]:
    """Coloured clouds, with depth images projected back behind a tab; and what clouds hide: marks inside of gloves."""
    depth = [f"{camera}/{DEPTH_IMAGE}" for camera in sensed.cameras]
    color = [f"{camera}/{COLOR_IMAGE}" for camera in sensed.cameras]
    cameras = [f"{camera}/**" for camera in sensed.cameras]
    tabs = rrb.Tabs(
        _scene_view("Workspace [m], z up", depth, _EYE, _LOOKS_AT),
        _scene_view("Depth images in space [m], z up", [*sensed.clouds, *color], _EYE, _LOOKS_AT),
        active_tab=0,
    )
    return tabs, _scene_view("Markers alone [m], z up", [*sensed.clouds, *cameras], _NEAR_EYE, _NEAR_LOOKS_AT)


def _scene_view(name: str, hidden: Sequence[str], eye: Point, looks_at: Point, grid: bool = True) -> rrb.Spatial3DView:
    contents = ["+ /space/**", *(f"- /space/{entity}" for entity in hidden)]
    controls = rrb.EyeControls3D(position=eye, look_target=looks_at, eye_up=(0.0, 0.0, 1.0))
    # The viewer's grid lies at z = 0: in the way where surfaces have a floor of their own.
    lines = rrb.LineGrid3D(visible=grid)
    return rrb.Spatial3DView(origin="/space", contents=contents, name=name, eye_controls=controls, line_grid=lines)


def _image_views(sensed: Sensed) -> rrb.Tabs:
    """The images of all cameras, with the markers where each camera would see them."""
    marks = [f"+ /space/{entity}" for entity in sensed.markers]

    def column(name: str, pinhole: str) -> rrb.Vertical:
        return rrb.Vertical(*(_image_view(camera, name, pinhole, marks) for camera in sensed.cameras), name=name)

    return rrb.Tabs(column("Colour", COLOR_CAMERA), column("Depth", DEPTH_CAMERA), active_tab=0)


def _image_view(camera: str, name: str, pinhole: str, marks: Sequence[str]) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=f"/space/{camera}/{pinhole}",
        contents=["+ $origin/**", *marks],
        name=f"{camera.rsplit('/', 1)[-1]}: {name.lower()}",
    )


def _axis(timeline: str, last: Moment | None) -> rrb.TimeAxis | None:
    if last is None:
        return None
    if timeline == "time":
        ends = [rrb.TimeRangeBoundary.absolute(seconds=value) for value in (0.0, last.time)]
    else:
        ends = [rrb.TimeRangeBoundary.absolute(seq=value) for value in (0, last.samples_seen)]
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=ends[0], end=ends[1]))


def _plot_view(entity: str, title: str, axis: rrb.TimeAxis | None) -> rrb.TimeSeriesView:
    # The legend stands where it hides least: scores fall from the left, signals are predicted towards the right.
    corner = rrb.Corner2D.RightTop if entity.startswith("scores") else rrb.Corner2D.LeftTop
    return rrb.TimeSeriesView(origin=f"/plots/{entity}", name=title, axis_x=axis, plot_legend=rrb.PlotLegend(corner))
