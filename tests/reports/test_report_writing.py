from __future__ import annotations

import csv

import pyarrow.parquet
import pytest
from sweep_world import leave_run, leave_sweep

from eaip_prob.reports import Run, read_runs, runs_table, section, sections, statistics_table, write_csv, write_parquet

COLUMNS = ["mean", "low", "high", "num_seeds", "difference", "difference_low", "difference_high", "num_pairs"]


@pytest.fixture
def sweep(tmp_path):
    values = {"5": {0: {"rmse": 1.0}, 1: {"rmse": 2.0}}, "10": {0: {"rmse": 4.0}}}
    return leave_sweep(tmp_path / "sweep", values, key="num_train")


def test_the_tidy_table_has_numbers_and_nulls(sweep):
    table = statistics_table(sections(read_runs(sweep)))
    assert table.column_names == ["experiment", "num_train", "metric", *COLUMNS]
    types = {field.name: str(field.type) for field in table.schema}
    assert types["num_train"] == types["num_seeds"] == types["num_pairs"] == "int64"
    assert types["experiment"] == types["metric"] == "string"
    assert all(types[name] == "double" for name in COLUMNS if not name.startswith("num_"))
    five, ten = table.to_pylist()
    assert (five["num_train"], five["mean"], five["num_seeds"], five["difference"]) == (5, 1.5, 2, None)
    assert (ten["low"], ten["high"], ten["difference"], ten["difference_low"], ten["num_pairs"]) == (
        None,
        None,
        3,
        None,
        1,
    )


def test_csv_and_parquet_hold_the_same(sweep, tmp_path):
    table = statistics_table(sections(read_runs(sweep)))
    write_csv(table, tmp_path / "report.csv")
    write_parquet(table, tmp_path / "report.parquet")
    assert pyarrow.parquet.read_table(tmp_path / "report.parquet") == table
    with (tmp_path / "report.csv").open() as file:
        read = list(csv.DictReader(file))
    assert list(read[0]) == table.column_names
    for texts, values in zip(read, table.to_pylist(), strict=True):
        for name, value in values.items():
            text = texts[name]
            assert text == ("" if value is None else text) and (value is None or type(value)(text) == value)


def test_files_are_replaced_in_one_step(sweep, tmp_path, monkeypatch):
    path = tmp_path / "report.csv"
    path.write_text("before")

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    table = statistics_table(sections(read_runs(sweep)))
    with monkeypatch.context() as patch:
        patch.setattr("os.replace", full_disk)
        with pytest.raises(OSError, match="No space"):
            write_csv(table, path)
    assert path.read_text() == "before" and [p.name for p in tmp_path.iterdir() if p.is_file()] == ["report.csv"]
    write_csv(table, path)
    assert path.read_text().startswith('"experiment"')


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        (("1", "2"), "int64"),
        (("1", "2.5"), "double"),
        (("1e-3", "2"), "double"),
        (("1", "many"), "string"),
        (("[1,2]", "3"), "string"),
        (("1", str(2**70)), "string"),
        (("true", "false"), "string"),
    ],
)
def test_choices_are_numbers_where_all_are(values, kind):
    runs = [Run(v, "finished", "x", {"size": v}, (f"size={v}",), {"rmse": 1.0}) for v in values]
    table = statistics_table([section("x", runs)])
    assert str(table.schema.field("size").type) == kind


def test_a_choice_with_the_name_of_a_column_gets_another(tmp_path):
    leave_sweep(tmp_path, {"a": {0: {"rmse": 1.0}}, "b": {0: {"rmse": 2.0}}}, key="mean")
    found = sections(read_runs(tmp_path))
    assert statistics_table(found).column_names[1:4] == ["config.mean", "metric", "mean"]
    assert statistics_table(found)["config.mean"].to_pylist() == ["a", "b"]


def test_experiments_share_one_table_with_nulls_for_the_choices_of_others(tmp_path):
    leave_sweep(tmp_path / "x", {"a": {0: {"rmse": 1.0}}, "b": {0: {"rmse": 2.0}}}, experiment="handover")
    leave_sweep(tmp_path / "y", {"5": {0: {"rmse": 7.0}}, "9": {0: {"rmse": 8.0}}}, key="num", experiment="timing")
    rows = statistics_table(sections(read_runs(tmp_path))).to_pylist()
    assert [(row["experiment"], row["model"], row["num"]) for row in rows] == [
        ("handover", "a", None),
        ("handover", "b", None),
        ("timing", None, 5),
        ("timing", None, 9),
    ]


def test_every_run_has_a_row(sweep):
    leave_run(sweep / "z", {"num_train": "10", "seed": 1}, None, ["num_train=10", "seed=1"], error="Too cold.\n")
    (sweep / "num_train=5,seed=0" / "config.yaml").write_text("[")
    leave_run(sweep / "zz", {"num_train": "10", "seed": 0}, {"rmse": 4.0, "seconds/total": 2.0}, ["num_train=10"])
    runs = read_runs(sweep)
    table = runs_table(runs, sections(runs))
    assert table.column_names == ["experiment", "run", "state", "seed", "num_train", "seconds", "sentence"]
    rows = {row["run"]: row for row in table.to_pylist()}
    assert rows["z"]["state"] == "failed" and rows["z"]["sentence"] == "Too cold." and rows["z"]["seed"] == 1
    assert rows["num_train=5,seed=0"]["state"] == "damaged" and rows["num_train=5,seed=0"]["num_train"] is None
    assert "only that one counts" in rows["num_train=10,seed=0"]["sentence"]
    assert rows["zz"]["seconds"] == 2.0 and len(rows) == 5


def test_nothing_finished_is_an_empty_table(tmp_path):
    leave_run(tmp_path / "a", {"seed": 0})
    table = statistics_table(sections(read_runs(tmp_path)))
    assert len(table) == 0 and table.column_names == ["experiment", "metric", *COLUMNS]
    write_csv(table, tmp_path / "report.csv")
    write_parquet(table, tmp_path / "report.parquet")
    assert pyarrow.parquet.read_table(tmp_path / "report.parquet").num_rows == 0
