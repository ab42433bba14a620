"""Random lengths, choices and colours of rendered furniture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eaip_prob.simulation.meshes import Color

WHOLE, AXIS = (0.6, 1.4), (0.8, 1.25)  # factors on the lengths of the piece that was demonstrated
_BAND = 0.5  # width of the band around a range, as a share of the range's logarithm


@dataclass(frozen=True, eq=False)
class Draw:
    """Random lengths, choices and colours of one instance.

    Args:
        generator: of all of them.
        unusual: lengths from the bands around their ranges instead of from inside.

    Example:
        >>> draw, odd = Draw(np.random.default_rng(0)), Draw(np.random.default_rng(0), unusual=True)
        >>> 1.0 <= draw.length(1.0, 2.0) <= 2.0, 1.0 <= odd.length(1.0, 2.0) <= 2.0
        (True, False)
    """

    generator: np.random.Generator
    unusual: bool = False

    def length(self, low: float, high: float) -> float:
        """Log-uniform in a range, or in the bands below and above it.

        Args:
            low: of the range, above zero.
            high: of the range.
        """
        share = float(self.generator.random())
        if self.unusual:
            share = -_BAND * 2.0 * share if share < 0.5 else 1.0 + _BAND * (2.0 * share - 1.0)
        return low * (high / low) ** share

    def chance(self, probability: float) -> bool:
        """Whether something with this probability happens."""
        return bool(self.generator.random() < probability)

    def count(self, low: int, high: int) -> int:
        """A number from low to high, both included."""
        return int(self.generator.integers(low, high + 1))

    def color(self, like: Color | None = None) -> Color:
        """RGB from 0 to 1: of any hue, greys and pale ones more often; or somewhat like another colour."""
        import colorsys

        g = self.generator
        if like is not None and g.random() < 0.5:
            return tuple(np.clip(np.asarray(like) * g.uniform(0.6, 1.25) + g.normal(0.0, 0.03, 3), 0.02, 0.98).tolist())
        return colorsys.hsv_to_rgb(g.random(), g.random() ** 1.5 * 0.9, g.uniform(0.08, 0.97))

    def axes(self, *lengths: float) -> tuple[float, ...]:
        """Lengths of the demonstrated piece times a common factor and one of each axis, m."""
        whole = self.length(*WHOLE)
        return tuple(length * whole * self.length(*AXIS) for length in lengths)
