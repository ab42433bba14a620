from __future__ import annotations

import numpy as np
import pytest
import torch

from eaip_prob.errors import InputError
from eaip_prob.tables import text_table


def test_lines_align_and_keep_order() -> None:
    rows = [{"method": "mean", "rmse": 123.456}, {"method": "eaip_shuffled", "rmse": 0.00012345, "n": 7}]
    lines = text_table(rows).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert [cell.strip() for cell in lines[0].strip("|").split("|")] == ["method", "rmse", "n"]
    assert [cell.strip() for cell in lines[2].strip("|").split("|")] == ["mean", "123.5", ""]
    assert [cell.strip() for cell in lines[3].strip("|").split("|")] == ["eaip_shuffled", "0.0001234", "7"]
    assert lines[1].startswith("|:--")
    assert lines[1].endswith("-:|")


def test_columns_select_and_large_whole_numbers_stay_whole() -> None:
    table = text_table([{"a": 123_456, "b": 1.0, "c": np.float64(2.25)}], columns=["c", "a"], digits=2)
    assert table.splitlines()[2] == "| 2.2 | 123456 |"


def test_odd_cells() -> None:
    table = text_table([{"x": "a|b\nc", "y": None, "z": float("nan")}, {"x": True, "y": 1.5, "z": -float("inf")}])
    assert r"a\|b c" in table
    assert table.count("\n") == 3
    assert "nan" in table
    assert "-inf" in table


def test_tensor_scalars_are_text_only_if_given_as_tensors() -> None:
    assert "0.25" in text_table([{"x": torch.tensor(0.25).item()}])


def test_unknown_column_is_refused() -> None:
    with pytest.raises(InputError, match="columns among"):
        text_table([{"a": 1}], columns=["b"])
    with pytest.raises(InputError, match="at least one"):
        text_table([])


@pytest.mark.parametrize(
    ("value", "shown"), [(10213.4, "10213"), (-99999.6, "-100000"), (9999.4, "9999"), (1e12, "1e+12"), (1e-7, "1e-07")]
)
def test_large_numbers_are_written_out(value, shown):
    assert text_table([{"dtw": value}]).splitlines()[-1].strip("| ") == shown
