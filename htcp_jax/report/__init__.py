"""Reports of sweeps: the paper's tables, charts, and the document that holds them (HTML, Markdown, CSV)."""
