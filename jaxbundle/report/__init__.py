"""Results in words, tables and pictures: pure functions of an adjustment, and those that write them.

sections         what a report consists of, made once; text, data, files and html render it
pictures         the numbers of the pictures, which html and plot draw alike
html             the page; plot: the same pictures in matplotlib, loaded as `jb.plot`
comparison       two results of one block, or two surveys of the same points
surveys          the test of two surveys by their covariances
ply, rerun_file  point clouds and stations for viewers
made             program, date, command and inputs
"""

from jaxbundle.report.comparison import compare_reports, congruency
from jaxbundle.report.data import report_dict
from jaxbundle.report.files import write_report
from jaxbundle.report.html import report_html, write_html
from jaxbundle.report.method_report import write_method_report
from jaxbundle.report.ply import to_ply
from jaxbundle.report.rerun_file import to_rerun
from jaxbundle.report.surveys import survey_congruency
from jaxbundle.report.text import report_text

__all__ = [
    "compare_reports",
    "congruency",
    "report_dict",
    "report_html",
    "report_text",
    "survey_congruency",
    "to_ply",
    "to_rerun",
    "write_html",
    "write_method_report",
    "write_report",
]
