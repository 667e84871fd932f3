"""Reports that can be sent: one self-contained HTML file, made from tables alone."""

from pfdist.reports.filtered_report import write_filtered_report
from pfdist.reports.run_report import remove_report, write_report
from pfdist.reports.sweep_report import write_sweep_report

__all__ = [
    "remove_report",
    "write_filtered_report",
    "write_report",
    "write_sweep_report",
]
