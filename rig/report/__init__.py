"""A calibration as one page for the browser: tables, budgets and the paper's figures, drawn from the runs."""

from rig.report.page import write_report

__all__ = ["write_report"]
