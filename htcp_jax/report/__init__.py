"""Reports of sweeps: tables, charts, and the document that contains them (HTML, Markdown, CSV).

`make_report` reads runs and returns a `Report` with all tables and figures. `write_report` writes it into a folder, and
`report_record` converts it for JSON. `charts` draws single figures from arrays, also without a report. The
command line prints the same `Table`s.

`chapter` makes the chapter on one part of a run. `tables` contains the tables of results, `timing` the tables of
cycle times and feed rates, `validation` the tables of the independent validation, and `gate` the verdict of a
comparison with a baseline, for CI. `draw_search` draws the results of a placement search.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
