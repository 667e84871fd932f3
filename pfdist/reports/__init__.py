"""Reports that can be sent: one self-contained HTML file, made from tables alone."""

from pfdist.reports.filtered_report import write_filtered_report
from pfdist.reports.render import check_page_replaceable
from pfdist.reports.run_report import REPORT, has_report, remove_report, write_report

__all__ = [
    "REPORT",
    "check_page_replaceable",
    "has_report",
    "remove_report",
    "write_filtered_report",
    "write_report",
]
