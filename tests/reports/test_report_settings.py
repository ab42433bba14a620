from __future__ import annotations

import pytest

from eaip_prob.errors import InputError
from eaip_prob.reports import Run, Setting, settings
from eaip_prob.reports.settings import check_choice, setting_of


def run(name: str, overrides: tuple[str, ...] = (), **config) -> Run:
    return Run(name, "finished", config=config, overrides=overrides)


def labels(runs) -> dict[str, str]:
    return {name: setting.label for name, setting in settings(runs).items()}


def test_overrides_that_differ_are_the_label():
    runs = [
        run("a", ("model=gaussian", "num_train=5"), model="G", num_train=5, seed=0),
        run("b", ("model=kernel", "num_train=5"), model="K", width=3, num_train=5, seed=0),
    ]
    assert labels(runs) == {"a": "model=gaussian", "b": "model=kernel"}


def test_seeds_threads_and_recording_are_no_setting():
    runs = [run(str(n), seed=n, threads=n + 1, **{"recording._target_": str(n)}) for n in range(3)]
    found = settings(runs)
    assert len(set(found.values())) == 1 and set(labels(runs).values()) == {"all runs"}


def test_a_choice_that_only_some_make_and_one_that_is_spelled_out():
    runs = [
        run("a", (), model="G", seed=0),
        run("b", ("model=gaussian",), model="G", seed=1),
        run("c", ("model=kernel",), model="K", seed=0),
        run("d", ("model=kernel", "+noise=2.0"), model="K", noise=2.0, seed=0),
        run("e", ("model=kernel", "~phase"), model="K", phase=None, seed=0),
    ]
    assert labels(runs) == {
        "a": "model=gaussian",
        "b": "model=gaussian",
        "c": "model=kernel",
        "d": "model=kernel noise=2.0",
        "e": "model=kernel ~phase",
    }
    assert set(labels([runs[0], runs[2]]).values()) == {"default", "model=kernel"}


def test_the_package_of_a_group_is_left_out_where_the_group_tells():
    one, two = "covariance@predictor.model.covariance", "covariance@paper.model.covariance"
    runs = [run(name, (f"{one}={name}",), covariance=name) for name in "ab"]
    assert labels(runs) == {"a": "covariance=a", "b": "covariance=b"}
    runs = [run(name, (f"{one}={name}", f"{two}={name}"), covariance=name) for name in "ab"]
    assert labels(runs)["a"] == f"{two}=a {one}=a"


def test_without_overrides_parts_are_named_by_their_classes():
    runs = [
        run("a", **{"predictor.model._target_": "x.Gaussian", "predictor.model.block": 1, "seed": 0}),
        run("b", **{"predictor.model._target_": "x.Kernel", "predictor.model.inner._target_": "x.Y", "seed": 0}),
        run("c", **{"predictor.model._target_": "x.Kernel", "predictor.model.inner._target_": "x.Y", "seed": 1}),
    ]
    assert labels(runs) == {
        "a": "predictor.model=Gaussian",
        "b": "predictor.model=Kernel",
        "c": "predictor.model=Kernel",
    }


def test_arguments_are_shown_where_the_classes_do_not_tell():
    runs = [run(str(n), **{"model._target_": "x.Kernel", "model.width": n}) for n in range(2)]
    assert labels(runs) == {"0": "model.width=0", "1": "model.width=1"}
    runs.append(run("2", **{"model._target_": "x.Gaussian"}))
    assert labels(runs)["1"] == "model._target_=x.Kernel model.width=1"


def test_overrides_that_hide_a_difference_are_not_trusted():
    runs = [run(str(n), ("model=kernel",), model="K", width=n) for n in range(2)]
    assert labels(runs) == {"0": "width=0", "1": "width=1"}


def test_settings_are_in_the_order_of_their_numbers_with_the_default_first():
    runs = [run(str(n), (f"num_train={n}",), num_train=n) for n in (10, 9, 100)] + [run("d", (), num_train=3)]
    assert list(labels(runs).values()) == ["default", "num_train=9", "num_train=10", "num_train=100"]


def test_a_whole_label_goes_before_parts_of_others():
    known = [Setting(), Setting((("m", "a"),)), Setting((("m", "a"), ("n", "5")))]
    assert [setting_of(label, known) for label in ("default", "m=a", "m=a n=5", "5")] == [*known, known[2]]


def test_a_label_finds_its_setting_whole_or_in_part():
    runs = [run(f"{m}{n}", (f"m={m}", f"n={n}"), m=m, n=n) for m in "ab" for n in (5, 55)]
    known = list(settings(runs).values())
    for label, expected in {"m=a n=5": 0, "n=55, m=b": 3, "b 5": 2, "a n=55": 1}.items():
        assert setting_of(label, known) == known[expected]
    for label in ("a", "m", "c", "m=a n=5 5 6", ""):
        with pytest.raises(InputError, match=r"Expected baseline.*'m=a n=5', 'm=a n=55', 'm=b n=5', 'm=b n=55'"):
            check_choice(label, known)
