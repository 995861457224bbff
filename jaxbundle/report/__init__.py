"""Results in words and tables: pure functions of an adjustment, and one that writes them to a folder."""

from jaxbundle.report.data import report_dict
from jaxbundle.report.files import write_report
from jaxbundle.report.method_report import write_method_report
from jaxbundle.report.text import report_text

__all__ = ["report_dict", "report_text", "write_method_report", "write_report"]
