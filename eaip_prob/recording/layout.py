"""The layout with which the viewer opens a recording: paths beside plots beside the report."""

from __future__ import annotations

import rerun.blueprint as rrb

from eaip_prob.recording.records import Layout, Moment

Bounds = tuple[tuple[float, float], tuple[float, float]]

_MARGIN = 0.08


def viewer_blueprint(layout: Layout, bounds: Bounds | None, last: Moment | None) -> rrb.Blueprint:
    """The rerun blueprint of a layout.

    Args:
        layout: what to show.
        bounds: ((x, y) smallest, (x, y) largest) of the plane, y up, or None for the viewer's own choice.
        last: where the timelines end, so that all plots have one horizontal axis, or None where it is not known yet.
    """
    axis = _axis(layout.timeline, last)
    plots = [_plot_view(entity, title, axis) for entity, title in layout.plots.items()]
    report = rrb.TextDocumentView(origin="/report", name="Report")
    if layout.kind == "plots":
        shown = rrb.Grid(*plots, report)
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
