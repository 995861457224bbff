"""Reports of results: texts, tables and pictures as pure functions of an adjustment, and functions that write them.

sections         the content of a report; text, data, files and html render it
pictures         the numbers of the pictures, drawn by html and plot
html             the HTML page; plot: the same pictures in matplotlib, as `jb.plot`
comparison       two results of one block, or two surveys of the same points
ply              point clouds for viewers
made             program, date, command and inputs
"""

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
