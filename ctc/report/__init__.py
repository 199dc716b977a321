"""One HTML page of an identification and its controller: `write_report`.

Read `report`, then `sections` and `page`.
"""

from ctc.report.page import figure, page, section, thin
from ctc.report.report import write_report

__all__ = ["figure", "page", "section", "thin", "write_report"]
