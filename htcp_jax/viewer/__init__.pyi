from . import movie, offscreen, plot_strip, replay, timed_play
from .arm_picture import draw_arm
from .browser.page import Viewer
from .normal_glyphs import glyphs
from .picture import draw_cell, draw_plan
from .render import Studio

__all__ = [
    "Studio",
    "Viewer",
    "draw_arm",
    "draw_cell",
    "draw_plan",
    "glyphs",
    "movie",
    "offscreen",
    "plot_strip",
    "replay",
    "timed_play",
]
