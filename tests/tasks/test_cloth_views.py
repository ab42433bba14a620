from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from covering_world import case
from detection_world import camera

from eaip_prob.errors import InputError
from eaip_prob.simulation import KinectNoise
from eaip_prob.tasks.bag_covering.cloth_views import ClothViews


def views(count=3, **changes):
    return replace(ClothViews("bookshelf", camera(), count, KinectNoise(), 1, case()), **changes)


def test_the_bag_hides_more_and_more_of_the_object(tmp_path):
    frames = views().frames(tmp_path)
    covered = [frame.objects[0].covered for frame in frames]
    assert [frame.time for frame in frames] == pytest.approx([1 / 6, 1 / 2, 5 / 6], abs=1e-9)
    assert covered[0] < 0.6 and covered[2] > 0.8 and covered == sorted(covered)
    (path,) = tmp_path.iterdir()
    stamp = path.stat().st_mtime_ns
    again = views().frames(tmp_path)
    assert path.stat().st_mtime_ns == stamp
    for one, other in zip(frames, again, strict=True):
        np.testing.assert_array_equal(one.color, other.color)
        np.testing.assert_array_equal(one.objects[0].box, other.objects[0].box)


def test_whatever_changes_the_frames_changes_the_key():
    others = [views(4), views(seed=2), views(label="chair"), views(case=case(number=1)), views(case=case("end_table"))]
    assert len({one.key() for one in (views(), *others)}) == 6


def test_a_single_frame_is_refused():
    with pytest.raises(InputError, match="two frames"):
        views(1)
