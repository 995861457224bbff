from jaxbundle.report.html.page import html_of as html_of, report_html as report_html, write_html as write_html
