"""Pictures and movies of plans, and the page in the browser.

`draw_plan` and `draw_cell` draw a plan or a workcell as a picture, `draw_arm` an arm alone. `replay` has plans ready to
be drawn, and `timed_play` plays them by a program's own time. `Studio` makes pictures of one plan from any side, and
`movie` writes a sequence of them as GIF or movie, with a `plot_strip` of plots below. `offscreen` finds a platform of
OpenGL that works without a screen. `glyphs` are the normals along the path.

`Viewer` serves the page with timeline and plots, and restricts who may open it.

MuJoCo, matplotlib and viser are imported by the modules that need them, when they are used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
