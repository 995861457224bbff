"""Results in words and tables: pure functions of an adjustment, and one that writes them to a folder."""

from jaxbundle.report.files import write_report
from jaxbundle.report.findings import Finding, findings
from jaxbundle.report.tables import report_dict
from jaxbundle.report.text import report_text

__all__ = ["Finding", "findings", "report_dict", "report_text", "write_report"]
