"""Reports over the runs of a sweep: what each run folder holds, means and intervals over seeds, tables and figures.

    runs = read_runs("runs/passing_over/sweep")
    statistics_table(sections(runs))  # a row for each setting and metric

Runs are read as they are: those that still run, were stopped, failed or are damaged are named and do not count. torch,
matplotlib and pyarrow are imported by what needs them.
"""

from eaip_prob.reports.page import chosen_metrics, page, summary, tables
from eaip_prob.reports.reading import STATES, Run, read_runs
from eaip_prob.reports.selecting import checked_patterns, selected
from eaip_prob.reports.settings import Setting, settings
from eaip_prob.reports.statistics import Row, Section, SeedInterval, section, sections, seed_interval
from eaip_prob.reports.writing import runs_table, statistics_table, write_csv, write_parquet

__all__ = [
    "STATES",
    "Row",
    "Run",
    "Section",
    "SeedInterval",
    "Setting",
    "checked_patterns",
    "chosen_metrics",
    "page",
    "read_runs",
    "runs_table",
    "section",
    "sections",
    "seed_interval",
    "selected",
    "settings",
    "statistics_table",
    "summary",
    "tables",
    "write_csv",
    "write_parquet",
]
