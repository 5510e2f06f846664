"""Pictures and movies of plans, and the page in the browser.

`draw_plan` draws a plan, `draw_cell` an arm in its workpiece, `draw_arm` an arm alone. `replay` prepares plans for
display; `timed_play` samples a robot program for playback. `Studio` renders the pictures and movies of one plan,
`movie` writes a movie as GIF or MP4, and `plot_strip` draws plots below it. `offscreen` finds an OpenGL platform that
works without a screen. `glyphs` returns lines along the path's normals.

`Viewer` serves the browser page with timeline and plots, and protects it from other pages and machines.

MuJoCo, matplotlib and viser are imported when a module that needs them is used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
