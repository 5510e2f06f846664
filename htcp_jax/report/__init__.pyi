from . import charts, gate, paper, program_facts, reach_study, timing_table, validation
from .chapter import part_facts
from .document import Table
from .place_pictures import best_pictures, draw_search
from .place_tables import read_search
from .plan_report import report_of_plan
from .proof_picture import draw_proof
from .report import chart, make_report, report_record, write_report
from .tables import result_row

__all__ = [
    "Table",
    "best_pictures",
    "chart",
    "charts",
    "draw_proof",
    "draw_search",
    "gate",
    "make_report",
    "paper",
    "part_facts",
    "program_facts",
    "reach_study",
    "read_search",
    "report_of_plan",
    "report_record",
    "result_row",
    "timing_table",
    "validation",
    "write_report",
]
