"""Reports of sweeps: the paper's tables, charts, and the document that holds them (HTML, Markdown, CSV).

`make_report` reads runs and makes all tables and figures, a `Report`; `write_report` writes it into a folder, and
`record` is its JSON. `charts` are the figures, each a function of a frame or of runs, for use by themselves. A `Table`
has `Column`s, and the command line prints the same tables.

`chapter` describes one run: job, choices, scenarios. `tables` has the tables of results, `timing` of execution times,
`validation` of the independent validation, and `gate` those of a comparison with a baseline, for a person and for CI.
`draw_search` draws a search for placements.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
