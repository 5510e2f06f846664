from . import chapter, charts, gate, reach_study, tables, timing_table, validation
from .document import Table
from .place_pictures import draw_search
from .report import make_report, report_record, write_report

__all__ = [
    "Table",
    "chapter",
    "charts",
    "draw_search",
    "gate",
    "make_report",
    "reach_study",
    "report_record",
    "tables",
    "timing_table",
    "validation",
    "write_report",
]
