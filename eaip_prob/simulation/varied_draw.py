"""Random lengths, choices and colours of rendered furniture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eaip_prob.simulation.meshes import Color

_BAND = 0.2  # width of the band around a range, as a share of the range's logarithm
_EVERY = 5  # one combination in so many is kept for unusual instances


@dataclass(frozen=True, eq=False)
class Draw:
    """Random lengths, choices and colours of one instance.

    Args:
        generator: of all of them.
        unusual: lengths from the bands around their ranges instead of from inside, and combinations of parts that no
            usual instance has.

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

    def choice(self, kinds: Sequence[str]) -> str:
        """One of several kinds of a part, each as often.

        Args:
            kinds: names.
        """
        return kinds[int(self.generator.integers(len(kinds)))]

    def matching(self, first: int, kinds: Sequence[str]) -> str:
        """A kind of a second part for one of a first part: every fifth combination is of unusual instances only.

        Args:
            first: place of the first part among its kinds.
            kinds: names of the second part's kinds, at least five.
        """
        return self.choice([k for at, k in enumerate(kinds) if ((first + at) % _EVERY == _EVERY - 1) == self.unusual])
