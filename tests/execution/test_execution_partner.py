from __future__ import annotations

import numpy as np
import pytest

from eaip_prob.errors import InputError
from eaip_prob.execution import PartnerReport, PartnerState, PartnerWatch
from eaip_prob.perception import HandState

STEP = 1.0 / 30.0
STILL = np.array([1.4, -0.6, -0.5])
COVARIANCE = np.tile(1e-6 * np.eye(3), (2, 1, 1))
BEGIN, OVER, END = np.array([1.4, -0.6, -0.15]), np.array([1.4, 0.0, 0.3]), np.array([1.4, 0.6, -0.5])


def line(*corners: np.ndarray, speed: float = 0.3) -> np.ndarray:
    """Points at 30 Hz along straight lines."""
    parts = [
        one
        + np.linspace(0.0, 1.0, max(int(np.linalg.norm(two - one) / speed / STEP), 1), endpoint=False)[:, None]
        * (two - one)
        for one, two in zip(corners[:-1], corners[1:], strict=True)
    ]
    return np.concatenate([*parts, corners[-1][None]])


def rest(at: np.ndarray, seconds: float) -> np.ndarray:
    return np.tile(at, (round(seconds / STEP), 1))


def watched(
    way: np.ndarray,
    watch: PartnerWatch | None = None,
    seen: np.ndarray | None = None,
    left: np.ndarray = STILL,
    noise: float = 0.0,
) -> list[PartnerReport]:
    """Reports along a way of the right hand; `seen` (T, 2)."""
    watch, rng = watch or PartnerWatch(pause=3.0), np.random.default_rng(0)
    state, reports = watch.init(), []
    for k, place in enumerate(way):
        visible = np.array([True, True]) if seen is None else seen[k]
        hands = HandState(k * STEP, np.stack([left, place]) + noise * rng.normal(size=(2, 3)), COVARIANCE, visible)
        report, state = watch.step(hands, k * STEP, state)
        reports.append(report)
    return reports


def statuses(reports: list[PartnerReport]) -> list[str]:
    """Each status once, in their order."""
    names = [report.status for report in reports]
    return [name for k, name in enumerate(names) if k == 0 or name != names[k - 1]]


@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_a_partner_who_covers_the_object_moves_all_the_way(noise):
    reports = watched(line(BEGIN, OVER, END), noise=noise)
    assert statuses(reports) == ["moves"]
    assert reports[-1].progress == pytest.approx(np.linalg.norm(OVER - BEGIN) + np.linalg.norm(END - OVER), abs=0.12)
    assert reports[-1].reason is None


def test_a_pause_is_a_stop_and_going_on_is_none():
    way = np.concatenate([line(BEGIN, OVER), rest(OVER, 4.0), line(OVER, END)])
    reports = watched(way, noise=0.002)
    assert statuses(reports) == ["moves", "stopped", "moves"]
    first = [report.status for report in reports].index("stopped")
    assert first * STEP == pytest.approx(len(line(BEGIN, OVER)) * STEP + 3.0, abs=0.2)
    assert "did not get on for 3." in str(reports[first].reason)


def test_a_short_pause_is_none():
    way = np.concatenate([line(BEGIN, OVER), rest(OVER, 2.5), line(OVER, END)])
    assert statuses(watched(way)) == ["moves"]


def test_who_never_begins_has_stopped():
    assert statuses(watched(rest(BEGIN, 4.0), noise=0.004)) == ["moves", "stopped"]


@pytest.mark.parametrize("beside", [0.0, 0.04])
def test_going_back_is_noticed_soon(beside):
    back = OVER + 0.5 * (BEGIN - OVER)
    way = np.concatenate([line(BEGIN, OVER), line(OVER, back) + [beside, 0.0, 0.0], line(back, OVER, END)])
    reports = watched(way)
    assert statuses(reports) == ["moves", "went_back", "moves"]
    first = [report.status for report in reports].index("went_back")
    gone = np.linalg.norm(way[first] - OVER - [beside, 0.0, 0.0])
    assert 0.05 < gone < 0.17
    assert str(reports[first].reason).startswith("The right hand went back by 0.1")


def test_a_hand_that_is_hidden_does_not_stop():
    way = np.concatenate([line(BEGIN, OVER), rest(OVER, 6.0), line(OVER, END)])
    seen = np.ones((len(way), 2), bool)
    hidden = slice(len(line(BEGIN, OVER)), len(line(BEGIN, OVER)) + len(rest(OVER, 6.0)))
    seen[hidden, 1] = False
    assert statuses(watched(way, seen=seen)) == ["moves"]


def test_nobody_seen_for_long_has_left_and_may_come_back():
    way = np.concatenate([line(BEGIN, OVER), rest(OVER, 4.0), line(OVER, END)])
    seen = np.ones((len(way), 2), bool)
    begin = len(line(BEGIN, OVER))
    seen[begin : begin + round(4.0 / STEP)] = False
    reports = watched(way, seen=seen)
    assert statuses(reports) == ["moves", "left", "moves"]
    first = [report.status for report in reports].index("left")
    assert (first - begin) * STEP == pytest.approx(3.0, abs=0.1)
    assert "none was seen" in str(reports[first].reason)


def test_hands_outside_the_workspace_have_left():
    away = np.array([3.0, 0.0, 0.0])
    reports = watched(np.concatenate([line(BEGIN, OVER), rest(away, 4.0)]), left=away)
    assert reports[-1].status == "left"
    assert "both were outside it" in str(reports[-1].reason)
    assert statuses(watched(np.concatenate([line(BEGIN, OVER), rest(away, 3.5)])))[-1] != "left"


def test_the_tracker_may_have_nothing_at_all():
    watch = PartnerWatch(unseen=1.0)
    state, names = watch.init(), []
    for time in (5.0, 5.5, 6.0, 6.5):
        report, state = watch.step(None, time, state)
        names.append(report.status)
    assert names == ["moves", "moves", "moves", "left"]


def test_the_other_hand_can_be_watched():
    assert statuses(watched(line(BEGIN, OVER, END), PartnerWatch(hand="left", pause=3.0))) == ["moves", "stopped"]


def test_states_are_passed_and_not_changed():
    watch = PartnerWatch()
    begun = watch.init()
    hands = HandState(0.0, np.stack([STILL, BEGIN]), COVARIANCE, np.array([True, True]))
    _, after = watch.step(hands, 0.0, begun)
    assert (len(begun.way), len(after.way)) == (0, 1)


def test_wrong_calls_are_refused():
    watch, hands = PartnerWatch(), HandState(0.0, np.full((2, 3), np.nan), COVARIANCE, np.array([False, True]))
    with pytest.raises(InputError, match="finite position of the right hand"):
        watch.step(hands, 0.0, watch.init())
    _, state = watch.step(None, 2.0, watch.init())
    for time in (1.9, float("nan")):
        with pytest.raises(InputError, match="not before the last step at 2 s"):
            watch.step(None, time, state)
    with pytest.raises(InputError, match="hands as HandState"):
        watch.step(STILL, 3.0, state)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="state as PartnerState"):
        watch.step(None, 3.0, None)  # pyright: ignore[reportArgumentType]
    assert isinstance(state, PartnerState)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("unseen", 0.0),
        ("pause", -1.0),
        ("back", float("nan")),
        ("spacing", 0.0),
        ("hand", "both"),
        ("low", (3.0, 0.0, 0.0)),
    ],
)
def test_settings_out_of_range_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        PartnerWatch(**{name: value})
