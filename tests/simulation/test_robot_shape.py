from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.errors import ShapeError
from eaip_prob.robot import NEUTRAL, baxter_left_arm, baxter_right_arm, link_points, mirrored
from eaip_prob.simulation import BaxterShape

LEFT, RIGHT = baxter_left_arm(), baxter_right_arm()
GRIPPERS = np.stack([LEFT.tip(NEUTRAL), RIGHT.tip(mirrored(NEUTRAL))])
ARMS = [link_points(LEFT, NEUTRAL), link_points(RIGHT, mirrored(NEUTRAL))]


def distance_to_line(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    along = np.diff(line, axis=0)
    share = np.einsum("pse,se->ps", points[:, None] - line[:-1], along) / (along**2).sum(1)
    feet = line[:-1] + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points[:, None] - feet, axis=-1).min(1)


def test_arms_are_drawn_along_their_links():
    shape = BaxterShape()
    bodies = len(shape.mesh(GRIPPERS).vertices) - 2 * len(shape._arm(np.array([0.0, 0.3, 0.3]), GRIPPERS[0], 1.0))
    assert bodies > 0
    vertices = shape.mesh(GRIPPERS, ARMS).vertices
    left = vertices[(vertices[:, 1] > 0.2) & (vertices[:, 2] > -0.5)]
    assert distance_to_line(left, ARMS[0]).max() == pytest.approx(0.06, abs=1e-9)
    for line, tip in zip(ARMS, GRIPPERS, strict=True):
        # Every corner of the line is inside what is drawn: its surface passes at the links' radius on all sides.
        for corner in line[:-2]:
            assert np.linalg.norm(vertices - corner, axis=1).min() < 0.0601
        assert np.linalg.norm(vertices - tip, axis=1).min() < 1e-9


def test_drawing_is_mirrored_with_the_arms():
    extent = BaxterShape().mesh(GRIPPERS, ARMS).extent()
    np.testing.assert_allclose(extent[0, 1], -extent[1, 1], atol=1e-6)


def test_arms_win_over_grippers():
    given = BaxterShape().mesh(GRIPPERS + 0.2, ARMS)
    np.testing.assert_array_equal(given.vertices, BaxterShape().mesh(GRIPPERS, ARMS).vertices)


@pytest.mark.parametrize(
    "arms", [ARMS[:1], [*ARMS, ARMS[0]], [ARMS[0], ARMS[1][:, :2]], [ARMS[0], ARMS[1][:3]], [ARMS[0], np.zeros(3)]]
)
def test_arms_that_cannot_be_drawn_are_refused(arms):
    with pytest.raises(ShapeError, match="Expected two arms, left and right"):
        BaxterShape().mesh(GRIPPERS, arms)
