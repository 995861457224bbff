"""Results in words and tables: pure functions of an adjustment, and one that writes them to a folder."""

from jaxbundle.report.comparison import compare_reports, congruency
from jaxbundle.report.data import report_dict
from jaxbundle.report.files import write_report
from jaxbundle.report.html import report_html, write_html
from jaxbundle.report.method_report import write_method_report
from jaxbundle.report.ply import to_ply
from jaxbundle.report.text import report_text

__all__ = [
    "compare_reports",
    "congruency",
    "report_dict",
    "report_html",
    "report_text",
    "to_ply",
    "write_html",
    "write_method_report",
    "write_report",
]
