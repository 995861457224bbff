from jaxbundle.report.comparison import compare_reports as compare_reports, congruency as congruency
from jaxbundle.report.data import report_dict as report_dict
from jaxbundle.report.files import write_report as write_report
from jaxbundle.report.html.page import report_html as report_html, write_html as write_html
from jaxbundle.report.method_report import write_method_report as write_method_report
from jaxbundle.report.point_cloud import to_ply as to_ply
from jaxbundle.report.rerun_file import to_rerun as to_rerun
from jaxbundle.report.surveys import Surveys as Surveys, survey_congruency as survey_congruency
from jaxbundle.report.text import report_text as report_text
