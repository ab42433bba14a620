"""Did a path pass neatly over a rectangle? Exact for the polyline between samples, batched.

The rectangle stands on y = 0 centred at x = 0. A path may not pass below it either, so the obstacle is the
rectangle together with everything under it: |x| <= width / 2 and y <= height. A path that starts on the left, ends
on the right and stays outside this column has passed over the top.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from eaip_prob.checks import as_float64, check_finite, check_positive, check_shape
from eaip_prob.errors import InputError, ShapeError


def passed(
    values: Float[Tensor, "*#batch time 2"],
    width: Float[Tensor, "*#batch"] | float,
    height: Float[Tensor, "*#batch"] | float,
    bound: float,
    seen: Bool[Tensor, "*#batch time"] | None = None,
) -> Bool[Tensor, "..."]:
    """True where a path starts left of the rectangle, ends right of it, and passes over it neatly.

    Neatly: no segment between two samples touches the rectangle (or what is under it), and the path never rises
    more than `bound` above the top.

    Args:
        values: x to the right and y up, px.
        width: of the rectangle, px; broadcast over the batch.
        height: of the rectangle, px; broadcast over the batch.
        bound: largest height above the top that still counts as neat, px.
        seen: False at padding, whose values are not read; default everything.

    Returns:
        the shape to which the batch of paths, the widths and the heights broadcast.

    Raises:
        ShapeError: values without a last axis of x and y.
        InputError: sizes or a bound that are not above zero, values that are not finite, or a path of which
            nothing was seen.

    Example:
        >>> path = torch.tensor([[-90.0, 0.0], [-60.0, 70.0], [60.0, 70.0], [90.0, 0.0]], dtype=torch.float64)
        >>> passed(path, 100.0, 50.0, bound=30.0), passed(path, 100.0, 80.0, bound=30.0)
        (tensor(True), tensor(False))
    """
    check_positive("bound", bound)
    values, width, height = _checked(values, width, height, seen)
    reaches = (values[..., 0, 0] < -width / 2) & (values[..., -1, 0] > width / 2)
    return reaches & (_distance(values, width, height) > 0) & (values[..., 1].amax(-1) - height <= bound)


def clearance(
    values: Float[Tensor, "*#batch time 2"],
    width: Float[Tensor, "*#batch"] | float,
    height: Float[Tensor, "*#batch"] | float,
    seen: Bool[Tensor, "*#batch time"] | None = None,
) -> Float[Tensor, "..."]:
    """Smallest distance, px, between a path and the rectangle with what is under it; 0 where it touches.

    The arguments and errors are those of `passed`.

    Example:
        >>> path = torch.tensor([[-90.0, 0.0], [-90.0, 70.0], [90.0, 70.0], [90.0, 0.0]], dtype=torch.float64)
        >>> clearance(path, 100.0, torch.tensor([50.0, 69.0, 71.0]))
        tensor([20.,  1.,  0.], dtype=torch.float64)
    """
    return _distance(*_checked(values, width, height, seen))


def rise(
    values: Float[Tensor, "*#batch time 2"],
    height: Float[Tensor, "*#batch"] | float,
    seen: Bool[Tensor, "*#batch time"] | None = None,
) -> Float[Tensor, "..."]:
    """Height, px, of the highest point of a path above the top of the rectangle; negative where it stays below.

    The arguments and errors are those of `passed`.

    Example:
        >>> rise(torch.tensor([[-90.0, 0.0], [0.0, 70.0], [90.0, 0.0]], dtype=torch.float64), 50.0)
        tensor(20., dtype=torch.float64)
    """
    values, _, height = _checked(values, 1.0, height, seen)
    return values[..., 1].amax(-1) - height


def _checked(
    values: Tensor, width: Tensor | float, height: Tensor | float, seen: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    values = as_float64("values", values)
    check_shape("values", values, ["T", 2])
    sizes = as_float64("width", width), as_float64("height", height)
    for name, size in zip(("width", "height"), sizes, strict=True):
        check_finite(name, size)
        if bool((size <= 0).any()):
            raise InputError(f"Expected {name} above zero, in px, got {float(size.min())}.")
    if seen is not None and seen.shape != values.shape[:-1]:
        raise ShapeError(f"Expected seen with shape {tuple(values.shape[:-1])}, got {tuple(seen.shape)}.")
    if values.shape[-2] == 0 or (seen is not None and not bool(seen.any(-1).all())):
        raise InputError("Expected at least one sample in every path, got a path without any.")
    check_finite("values", values, None if seen is None else seen[..., None])
    return (values if seen is None else _held(values, seen), *sizes)


def _held(values: Tensor, seen: Tensor) -> Tensor:
    """Each sample that was not seen replaced by the last seen before it (the first seen, at the beginning)."""
    number = torch.arange(values.shape[-2])
    first = seen.to(torch.int8).argmax(-1, keepdim=True)
    last = torch.maximum(torch.where(seen, number, 0).cummax(-1).values, first)
    return values.gather(-2, last[..., None].expand(values.shape))


def _distance(values: Tensor, width: Tensor, height: Tensor) -> Tensor:
    """Distance from the polyline to the column.

    The distance to a convex set is convex along a segment, and smooth outside the set. Its least value is therefore
    at an end of the segment or where the segment is nearest to a corner. A segment that cuts through the column cuts
    off a corner, whose nearest point is then inside, or goes through both sides and crosses x = 0 inside.
    """
    half, top = (width / 2)[..., None], height[..., None]
    nearest = _outside(values[..., 0], values[..., 1], half, top).amin(-1)
    if values.shape[-2] == 1:
        return nearest
    (x, y), (dx, dy) = values[..., :-1, :].unbind(-1), values.diff(dim=-2).unbind(-1)
    length, to_top = dx.square() + dy.square(), top - y
    candidates = [
        ((-half - x) * dx + to_top * dy, length),
        ((half - x) * dx + to_top * dy, length),
        (-x, dx),
    ]
    for numerator, denominator in candidates:
        # No length, or no way to the side: the ends of the segment, which are compared already, say everything.
        share = torch.where(denominator == 0, 0.0, numerator / torch.where(denominator == 0, 1.0, denominator))
        share = share.clamp(0.0, 1.0)
        nearest = torch.minimum(nearest, _outside(x + share * dx, y + share * dy, half, top).amin(-1))
    return nearest


def _outside(x: Tensor, y: Tensor, half: Tensor, top: Tensor) -> Tensor:
    return torch.hypot((x.abs() - half).clamp_min(0.0), (y - top).clamp_min(0.0))
